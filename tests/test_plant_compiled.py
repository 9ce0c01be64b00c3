"""The compiled kernel: renewed when any source changes, repeatable, fast enough to be told."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np

import plant
from plant import compiled
from plant.constants import nominal
from plant.simulator import kernel
from plant.simulator.bench import BenchSim
from plant.simulator.simulate import pulse_train, run_commands

FOLDER = Path(plant.__file__).parent


def test_the_cache_is_renewed_by_every_source_that_is_compiled_in() -> None:
    todo, seen = ["kernel"], set()
    while todo:
        name = todo.pop()
        seen.add(f"{name}.py")
        text = (FOLDER / f"{name}.py").read_text()
        found = re.findall(r"^from plant\.(\w+) import", text, re.M)
        for names in re.findall(r"^from plant import (.+)$", text, re.M):
            found += [part.split(" as ")[0].strip() for part in names.split(",")]
        todo += [other for other in found if f"{other}.py" not in seen]
    # Errors and the reading of files carry no numbers into compiled code.
    assert seen - {"errors.py", "tomlfile.py"} == set(compiled._SOURCES)


def test_the_fingerprint_is_part_of_what_the_cache_is_keyed_by() -> None:
    for entry in (kernel.advance, kernel.run):
        cells = [cell.cell_contents for cell in entry.py_func.__closure__]  # type: ignore[attr-defined]
        assert compiled.fingerprint() in cells


def test_the_same_commands_give_the_same_numbers_to_the_bit() -> None:
    rows = pulse_train("inlet", 0.0, 0.013, 0.04, 20) + pulse_train("outlet", 0.02, 0.013, 0.04, 20)
    first, second = (run_commands(nominal(), rows, 1.0, load="isotonic") for _ in "ab")
    assert np.array_equal(first.pressure_kpa, second.pressure_kpa)
    assert np.array_equal(first.length_mm, second.length_mm)


def test_an_hour_of_ticks_fits_a_minute_many_times_over() -> None:
    # 0.4 to 0.6 us a tick when the machine is quiet; the bound only catches a lost compilation.
    bench = BenchSim(nominal())
    state, params = bench.state, bench.params
    began = time.process_time()
    for k in range(20_000):
        kernel.advance(state, params, 1e-3, 1e-3 if k % 40 < 13 else 0.0, 0.0)
    assert (time.process_time() - began) / 20_000 < 10e-6
