"""`python -m tests.audit`: what the lock files pin, a bill of materials, and known holes.

Everything but the last needs only the files. For known holes the program pip-audit and a network
are needed; where either is missing the output says that nothing was audited, and the exit status
is 0: a build must not depend on somebody else's server.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HOUSE = Path(__file__).parent.parent
LOCK = HOUSE / "requirements.lock"
LOCKS = (LOCK, *sorted((HOUSE / "locks").glob("*.lock")))
PINNED = re.compile(r"([A-Za-z0-9._-]+)==([0-9][A-Za-z0-9.+!]*)(?: ; ([^;#@]+))?")
SUM = re.compile(r"--hash=sha256:([0-9a-f]{64})")
WAIT_S = 300.0


@dataclass(frozen=True)
class Pin:
    """One package of a lock file: its version, where it applies, and the sums of its files."""

    name: str
    version: str
    marker: str
    sums: tuple[str, ...]


def entries(text: str) -> Iterator[str]:
    """The requirements of a lock file, continued lines joined."""
    for line in re.sub(r"\\\n\s*", "", text).splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            yield line.strip()


def read_pin(entry: str) -> Pin | None:
    """The pin, or None where an entry is not one version with the sums of its files."""
    head, *sums = re.split(r"\s+(?=--hash=)", entry)
    named = PINNED.fullmatch(head.strip())
    found = [SUM.fullmatch(part.strip()) for part in sums]
    if named is None or not found or None in found:
        return None
    name, version, marker = named.groups()
    return Pin(name, version, marker or "", tuple(m[1] for m in found if m))


def loose(text: str) -> list[str]:
    """Entries that are not one version with the sums of its files; at most 100 characters each."""
    return [entry[:100] for entry in entries(text) if read_pin(entry) is None]


def pins(text: str) -> list[Pin]:
    """All pins of a lock file."""
    return [pin for pin in map(read_pin, entries(text)) if pin is not None]


def bill_of_materials(text: str) -> dict[str, Any]:
    """The packages of a lock file as CycloneDX 1.6; the same for the same file."""
    project = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    components = []
    for pin in pins(text):
        component: dict[str, Any] = {
            "type": "library",
            "bom-ref": f"{pin.name}=={pin.version}",
            "name": pin.name,
            "version": pin.version,
            "purl": f"pkg:pypi/{pin.name}@{pin.version}",
            "hashes": [{"alg": "SHA-256", "content": value} for value in pin.sums],
        }
        if pin.marker:
            component["properties"] = [{"name": "pamrig:marker", "value": pin.marker}]
        components.append(component)
    root = f"{project['name']}=={project['version']}"
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": project["name"],
                "version": project["version"],
            }
        },
        "components": components,
        "dependencies": [{"ref": root, "dependsOn": [c["bom-ref"] for c in components]}],
    }


def known_holes() -> int:
    """Ask pip-audit; 0 as well where it or its server is missing, which is printed."""
    tool = shutil.which("pip-audit") or shutil.which("pip-audit", path=str(Path(sys.prefix, "bin")))
    if tool is None:
        print("NOT AUDITED for known holes: needs pip-audit (locks/audit.lock)")
        return 0
    command = [tool, "--requirement", str(LOCK), "--no-deps", "--disable-pip"]
    try:
        done = subprocess.run(command, text=True, capture_output=True, timeout=WAIT_S, check=False)
    except subprocess.TimeoutExpired:
        print(f"NOT AUDITED for known holes: no answer within {WAIT_S:g} s")
        return 0
    if done.returncode and "Found" not in done.stderr + done.stdout:
        print(f"NOT AUDITED for known holes: {done.stderr.strip().splitlines()[-1:]}")
        return 0
    print(done.stdout + done.stderr)
    return done.returncode


def main() -> int:
    """Print what was checked; 1 where a pin is loose or a hole is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sbom", type=Path, help="write the bill of materials to this file")
    sbom: Path | None = parser.parse_args().sbom
    bad = 0
    for path in LOCKS:
        text = path.read_text(encoding="utf-8")
        found = loose(text)
        bad += len(found)
        for entry in found:
            print(f"{path.relative_to(HOUSE)}: not one version with its sums: {entry}")
        if not found:
            print(f"{path.relative_to(HOUSE)}: {len(pins(text))} versions, each with its sums")
    if bad:
        return 1
    if sbom is not None:
        sbom.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(bill_of_materials(LOCK.read_text(encoding="utf-8")), indent=1)
        sbom.write_text(text + "\n", encoding="utf-8")
        print(f"bill of materials (CycloneDX 1.6): {sbom}")
    return known_holes()


if __name__ == "__main__":
    sys.exit(main())
