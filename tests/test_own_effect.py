"""An effect from a package outside the repository: catalogue, plant and diagnosis take it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from conftest import HOUSE
from plant.effects import installed
from plant.effects.catalogue import CATALOGUE
from plant.effects.installed import GROUP, together
from plant.errors import PlantError

EXAMPLE = HOUSE / "docs" / "examples" / "effects" / "hose_push.py"
DIAGNOSIS = """
import json, sys
from pathlib import Path
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose_with_fit
from gap_sets import settled_set
push = float(sys.argv[1])
effects = {"hose_push": {"push_n": push}} if push else {}
data = read_dataset(settled_set(Path("set"), effects, replicates=4))
verdict, _, _ = diagnose_with_fit(data)
candidates = [list(named.ids) for named in verdict.effects]
print(json.dumps({"status": str(verdict.status), "named": candidates, "text": repr(verdict)}))
"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder with an installed package that brings the example."""
    package, info = tmp_path / "site" / "lab_bench", tmp_path / "site" / "lab_bench-1.0.dist-info"
    for folder in (package, info):
        folder.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "hose_push.py").write_text(EXAMPLE.read_text())
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-bench\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        f"[{GROUP}]\nhose_push = lab_bench.hose_push:HOSE_PUSH\n"
    )
    return tmp_path / "site"


def outside(site: Path, *words: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(site), str(HOUSE), str(HOUSE / "tests")])
    return subprocess.run(
        [sys.executable, *words], cwd=site.parent, capture_output=True, text=True, check=False,
        timeout=900, env={**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": ""},
    )  # fmt: skip


def test_it_stands_in_the_catalogue_and_confusion_is_mutual(site: Path) -> None:
    done = outside(site, "-m", "cli.main", "gap", "effects", "--json")
    assert done.returncode == 0, done.stderr
    entries = {entry["id"]: entry for entry in json.loads(done.stdout)}
    assert len(entries) == len(CATALOGUE) + 1
    assert entries["hose_push"]["stage"] == "muscle"
    page = outside(site, "-m", "cli.main", "gap", "effects", "force_gain")
    assert "hose_push" in page.stdout


def test_a_package_that_cannot_be_loaded_is_one_line(site: Path) -> None:
    (site / "lab_bench" / "hose_push.py").write_text("import nothing_of_that_name\n")
    done = outside(site, "-m", "cli.main", "gap", "effects")
    assert done.returncode == 2
    assert "pamrig.effects: hose_push" in done.stderr
    assert "nothing_of_that_name" in done.stderr
    assert "Traceback" not in done.stderr


def brought(monkeypatch: pytest.MonkeyPatch, made: Any, name: str = "hose_push") -> Any:
    monkeypatch.setattr(EntryPoint, "load", lambda point: made)
    return installed._load(EntryPoint(name, "lab_bench.hose_push:HOSE_PUSH", GROUP))


def example() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "example"}
    exec(compile(EXAMPLE.read_text(), str(EXAMPLE), "exec"), names)
    return names


def test_what_does_not_fit_the_catalogue_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    names = example()
    push = names["HOSE_PUSH"]
    assert brought(monkeypatch, push) is push
    with pytest.raises(PlantError, match="is not an Effect"):
        brought(monkeypatch, 3)
    with pytest.raises(PlantError, match="has the id 'hose_push'"):
        brought(monkeypatch, push, "other")
    own = CATALOGUE.values()
    assert together(own, [push])[-1] is push
    with pytest.raises(PlantError, match="is an effect already"):
        together(own, [push, push])
    from dataclasses import replace

    with pytest.raises(PlantError, match="share slot 75"):
        together(own, [push, replace(push, id="second")])
    with pytest.raises(PlantError, match="mistaken for 'nothing', unknown"):
        together(own, [replace(push, mistaken_for=("nothing",))])
    names["_slots"].__globals__["PER_PA"] = 41
    with pytest.raises(PlantError, match=r"uses slots \[41\]; allowed 75 to 95"):
        brought(monkeypatch, push)


@pytest.mark.campaign
def test_the_diagnosis_finds_it_where_it_is(site: Path) -> None:
    """In settled points; what is not there is not named."""
    (site / "try.py").write_text(DIAGNOSIS)
    for push in ("6.0", "0.0"):
        done = outside(site, str(site / "try.py"), push)
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        if push == "0.0":
            assert found["named"] == []
        else:
            assert "hose_push" in found["text"], found
        for path in sorted((site.parent / "set").iterdir()):
            path.unlink()
        (site.parent / "set").rmdir()
