"""Builds muscle.fmu from muscle.c with the C compiler of this machine.

    python build.py [--fmi 3] [--cc gcc] muscle.fmu

An FMU is a zip file: modelDescription.xml, and a shared library for each platform.
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

TOKEN = "{5b0d3d1e-4c0e-4a3f-9d57-0c7d1f6b2a10}"
# name, causality, start; the order is that of the enumeration in muscle.c.
VARIABLES = (
    ("p", "input", 0.0), ("length", "input", 0.06), ("inlet", "input", 0.0),
    ("outlet", "input", 0.0), ("supply", "input", 7e5), ("braid_length", "parameter", 0.085),
    ("turns", "parameter", 1.75), ("rate", "parameter", 5.0), ("force", "output", None),
    ("pressure", "output", None), ("fault", "parameter", 0.0),
)  # fmt: skip
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}


def build(target: Path, fmi: int = 2, compiler: str = "cc") -> Path:
    """Compile muscle.c and pack it. Raises `subprocess.CalledProcessError` with the messages."""
    system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
    ending = {"windows": ".dll", "darwin": ".dylib"}.get(system, ".so")
    folder = {"windows": "win64", "darwin": "darwin64"}.get(system, "linux64")
    if fmi == 3:
        folder = f"{_MACHINES[platform.machine().lower()]}-{system}"
    with tempfile.TemporaryDirectory() as scratch:
        library = Path(scratch) / f"muscle{ending}"
        source = Path(__file__).parent / "muscle.c"
        words = [compiler, "-O2", "-shared", "-fPIC", f"-DFMI={fmi}", str(source), "-o"]
        subprocess.run([*words, str(library), "-lm"], check=True, capture_output=True, text=True)
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed:
            packed.writestr("modelDescription.xml", description(fmi))
            packed.write(library, f"binaries/{folder}/{library.name}")
    return target


def description(fmi: int) -> str:
    """The text of modelDescription.xml for FMI 2 or 3."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>']
    kind = 'modelIdentifier="muscle" canHandleVariableCommunicationStepSize="true"'
    if fmi == 2:
        lines += [
            f'<fmiModelDescription fmiVersion="2.0" modelName="muscle" guid="{TOKEN}">',
            f"<CoSimulation {kind}/>",
        ]
    else:
        lines += [
            f'<fmiModelDescription fmiVersion="3.0" modelName="muscle" '
            f'instantiationToken="{TOKEN}">',
            f"<CoSimulation {kind}/>",
        ]
    lines += ['<DefaultExperiment stepSize="0.001"/>', "<ModelVariables>"]
    if fmi == 3:
        lines.append('<Float64 name="time" valueReference="99" causality="independent" '
                     'variability="continuous"/>')  # fmt: skip
    for reference, (name, causality, start) in enumerate(VARIABLES):
        variability = "fixed" if causality == "parameter" else "continuous"
        given = f' start="{start}"' if start is not None else ""
        common = (
            f'name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}"'
        )
        exact = ' initial="exact"' if causality == "parameter" else ""
        if fmi == 2:
            lines.append(f"<ScalarVariable {common}{exact}><Real{given}/></ScalarVariable>")
        else:
            lines.append(f"<Float64 {common}{exact}{given}/>")
    lines += ["</ModelVariables>", "<ModelStructure>"]
    outputs = [k for k, (_, causality, _) in enumerate(VARIABLES) if causality == "output"]
    if fmi == 2:
        rows = "".join(f'<Unknown index="{k + 1}"/>' for k in outputs)
        lines += [f"<Outputs>{rows}</Outputs>", f"<InitialUnknowns>{rows}</InitialUnknowns>"]
    else:
        lines += [f'<Output valueReference="{k}"/>' for k in outputs]
        lines += [f'<InitialUnknown valueReference="{k}"/>' for k in outputs]
    return "\n".join([*lines, "</ModelStructure>", "</fmiModelDescription>"]) + "\n"


if __name__ == "__main__":
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("target", type=Path)
    reader.add_argument("--fmi", type=int, choices=(2, 3), default=2)
    reader.add_argument("--cc", default="cc")
    wanted = reader.parse_args()
    build(wanted.target, wanted.fmi, wanted.cc)
