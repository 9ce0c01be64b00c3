"""`python -m blind make`: write blind sets as data folders, their answers apart."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from blind.exchange import write
from blind.recording import record
from blind.seal import seal
from blind.sets import answer, blind_set


def numbers_of(text: str) -> list[int]:
    """`7`, `0-59` or `3,5,8` as numbers."""
    out: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        out += list(range(int(first), int(last or first) + 1))
    return out


def main(arguments: list[str] | None = None) -> int:
    """Make practice sets; reserved ones are made by the blind check alone."""
    parser = argparse.ArgumentParser(prog="python -m blind", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("make", help="write practice sets")
    make.add_argument("--practice", required=True, help="numbers: 7, 0-59 or 3,5,8")
    make.add_argument("--out", type=Path, required=True, help="folder; several sets get subfolders")
    make.add_argument("--answer", action="store_true", help="write answer.json beside each folder")
    make.add_argument("--csv", action="store_true", help="samples.csv instead of samples.parquet")
    make.add_argument("--small", action="store_true", help="at most 16 trials")
    given = parser.parse_args(arguments)
    chosen = numbers_of(given.practice)
    for number in chosen:
        folder = given.out if len(chosen) == 1 else given.out / f"practice-{number:05d}"
        one = blind_set("practice", number, given.small)
        write(record(one), folder, given.csv)
        digest, envelope = seal(answer(one))
        print(json.dumps({"set": folder.as_posix(), "seal": digest, "without": list(one.without)}))
        if given.answer:
            beside = folder.with_name(folder.name + ".answer.json")
            beside.write_text(json.dumps(envelope, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
