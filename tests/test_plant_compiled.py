"""The compiled kernel: renewed when any source changes, repeatable, machine code throughout."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import plant
from plant import compiled, inner
from plant.constants import nominal
from plant.simulator import kernel, replay
from plant.simulator.bench import BenchSim
from plant.simulator.simulate import pulse_train, run_commands

FOLDER = Path(plant.__file__).parent


def test_the_cache_is_renewed_by_every_source_that_is_compiled_in() -> None:
    todo, seen = ["plant.simulator.kernel"], set()
    while todo:
        name = todo.pop()
        seen.add(name)
        place = FOLDER.parent.joinpath(*name.split("."))
        text = (place / "__init__.py" if place.is_dir() else place.with_suffix(".py")).read_text()
        found = re.findall(r"^from (plant[\w.]*) import", text, re.M)
        for room, names in re.findall(r"^from (plant[\w.]*) import ([\w, ]+)$", text, re.M):
            parts = [f"{room}.{part.split(' as ')[0].strip()}" for part in names.split(",")]
            found += [part for part in parts if _module(part)]
        todo += [other for other in found if other not in seen and other != "plant"]
    # Names of array types, errors and the reading of files carry no numbers into compiled code.
    carried = {
        name for name in seen if name not in ("plant.arrays", "plant.errors", "plant.tomlfile")
    }
    rooms = ("compiled", "constants", "effects", "inner", "physics", "simulator")
    assert {name.split(".")[1] for name in carried} == set(rooms)
    assert len(carried) > 40


def _module(name: str) -> bool:
    place = FOLDER.parent.joinpath(*name.split("."))
    return place.is_dir() or place.with_suffix(".py").is_file()


def test_a_change_in_an_inner_room_changes_the_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    before = compiled.fingerprint()
    sources = compiled._sources
    inner = [file.name for file in sources(FOLDER / "effects")]
    assert {"creep.py", "leak.py", "wear.py"} <= set(inner)
    monkeypatch.setattr(
        compiled, "_sources", lambda place: [f for f in sources(place) if f.name != "creep.py"]
    )
    assert compiled.fingerprint() != before


def test_the_fingerprint_is_part_of_what_the_cache_is_keyed_by() -> None:
    for entry in (kernel.advance, replay.run):
        cells = [cell.cell_contents for cell in entry.py_func.__closure__]  # type: ignore[attr-defined]
        assert compiled.fingerprint("simulator") in cells


def test_the_same_commands_give_the_same_numbers_to_the_bit() -> None:
    rows = pulse_train("inlet", 0.0, 0.013, 0.04, 20) + pulse_train("outlet", 0.02, 0.013, 0.04, 20)
    first, second = (run_commands(nominal(), rows, 1.0, load="isotonic") for _ in "ab")
    assert np.array_equal(first.pressure_kpa, second.pressure_kpa)
    assert np.array_equal(first.length_mm, second.length_mm)


def test_a_tick_is_machine_code_of_one_signature() -> None:
    """The interpreter, or a compilation for each new call, would cost a thousand times as much."""
    bench = BenchSim(nominal())
    for k in range(3):
        kernel.advance(bench.state, bench.params, 1e-3, 1e-3 * k, 0.0)
    entry: Any = kernel.advance
    assert len(entry.nopython_signatures) == len(entry.signatures) == 1


def test_what_is_only_compiled_into_others_refuses_a_call() -> None:
    """There is no machine code of it: the process would end."""
    with pytest.raises(TypeError, match="only compiled into other functions"):
        kernel.measure(np.zeros(8), np.zeros(8))
    plain = compiled.inlined(lambda x: x + 1.0)
    made = compiled.entry_point("float64(float64)")(_calling(plain))
    assert made(2.0) == 6.0


def _calling(function: Any) -> Any:
    def twice(x: float) -> float:
        return 2.0 * float(function(x))

    return twice


def test_another_version_of_numba_compiles_in_its_ordinary_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(inner, "KNOWN", ("0.0",))
    plain = compiled.inlined(lambda x: x + 1.0)
    assert plain(1.0) == 2.0
