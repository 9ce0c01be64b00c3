"""`python -m tests.board`: the firmware on an emulated RP2040; see --help."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from . import node
from .image import Unusable, read_bootrom, read_image
from .judge import misses
from .parts import FULL_SECONDS, FULL_TRIALS, Setting, run

NEEDED = (
    "board: skipped, needs IMAGE=RPI_PICO.uf2 (MicroPython for the Pico) and "
    "BOOTROM=bootrom.bin (16 kB, of the RP2040)"
)


def main() -> int:
    """Run what is asked for; 1 where a figure misses its limit."""
    parser = argparse.ArgumentParser(prog="python -m tests.board", description=__doc__)
    parser.add_argument("--image", type=_path, help="MicroPython's image, .uf2 or .bin")
    parser.add_argument("--bootrom", type=_path, help="boot ROM of the RP2040, .bin")
    parser.add_argument("--elf", type=Path, help="the image's ELF: counts collections as well")
    parser.add_argument("--seconds", type=float, default=FULL_SECONDS, help="of each scheme (60)")
    parser.add_argument("--trials", type=int, default=FULL_TRIALS, help="of each kind (1000)")
    parser.add_argument("--parts", default="", help="schemes[:name],trials[:kind],pulses,...")
    parser.add_argument("--processes", type=int, default=1, help="at a time (default 1)")
    parser.add_argument("--again", action="store_true", help="parts with a result once more")
    parser.add_argument("--work", type=Path, default=Path("out/board"), help="results of parts")
    parser.add_argument("--out", type=Path, default=Path("out/board.json"), help="all results")
    parser.add_argument("--page", type=Path, help="write the results there, as a page")
    args = parser.parse_args()
    if args.image is None or args.bootrom is None:
        print(NEEDED)
        return 0
    work = args.work.resolve()
    setting = Setting(args.image, args.bootrom.resolve(), args.elf, args.seconds, args.trials, work)
    wanted = [name for name in args.parts.split(",") if name]
    try:
        results = run(
            setting, wanted, args.processes, args.again, lambda text: print(text, flush=True)
        )
        board = read_image(args.image)
        bootrom = read_bootrom(args.bootrom)
    except (Unusable, OSError) as error:
        print(f"board: {error}")
        return 2
    except KeyboardInterrupt:
        print("stopped; run the same command again to continue")
        return 130
    missed = misses(results)
    about = {
        "image": args.image.name,
        "sha256": board.sha256,
        "micropython": board.version,
        "bootrom": bootrom,
        "emulator": f"{node.PACKAGE} {node.version()}",
        "seconds": args.seconds,
        "trials": args.trials,
    }
    args.out.parent.mkdir(parents=True, exist_ok=True)
    whole = {"about": about, "misses": missed, "parts": results}
    args.out.write_text(json.dumps(whole, indent=1) + "\n")
    if args.page is not None:
        from .page import write_page

        write_page(whole, args.page)
    for line in missed:
        print(f"MISSED {line}")
    print(f"{len(results)} parts, {len(missed)} figures outside their limits")
    return int(bool(missed))


def _path(text: str) -> Path | None:
    return Path(text) if text else None


if __name__ == "__main__":
    sys.exit(main())
