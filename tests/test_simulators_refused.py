"""What is wrong with a simulator, its description or its predictions is one line, before the work.

Each line names the file and the key, the function or the FMU, and the trial.
"""

from __future__ import annotations

import builtins
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gap.data.reader import read_dataset
from gap.errors import GapError
from gap.simulators.open import open_data_with, open_simulator, with_simulator
from gap_sets import settled_set
from plant.models import catalogue
from simulator_files import CHAMBER_FMU, FMU, FORCE, STATIC, built_fmu, trial, valve_trial, write

DYNAMIC = 'kind = "python"\nfunction = "muscle.py:force"\nstages = ["force"]\n'
MEASURED = trial(
    {"pressure_kpa": ([0.0, 1.0, 2.0], [0.0, 100.0, 200.0]), "force_n": ([0.5, 1.5], [0.0, 0.0])},
    name="t7",
)


def line(error: pytest.ExceptionInfo[GapError]) -> str:
    text = str(error.value)
    assert "\n" not in text
    return text


def refused(folder: Path, **files: str) -> str:
    """The line with which a description is refused."""
    path = write(folder, **files)
    with pytest.raises(GapError) as error:
        open_simulator(path)
    text = line(error)
    assert text.startswith(str(path))
    return text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "kind: expected one of python, fmu, predictions, law, surface, got nothing"),
        ('kind = "simulink"', "kind: expected one of"),
        ("kind = 3", "kind: expected one of"),
        ("kind = ", "cannot be read as TOML"),
        ('kind = "python"\nfunction = "a.py:b"', 'stages: expected a list such as ["force"]'),
        ('kind = "python"\nstages = "force"', "stages: expected a list"),
        ('kind = "python"\nstages = ["muscle"]', "stages: 'muscle' is not a stage"),
        ('kind = "python"\nstages = ["force", "force"]', "stages: names a stage twice"),
        ('kind = "python"\nstages = ["force"]\nfuncion = "a.py:b"', "did you mean function"),
        ('kind = "python"\nstages = ["force"]', "function: expected a text, got nothing"),
        ('kind = "python"\nstages = ["force"]\nfunction = "a"', 'function: expected "file.py'),
        (DYNAMIC + "static = 1", "static: expected true or false, got 1"),
        (DYNAMIC.replace('"force"]', '"force", "pressure"]') + "static = true", "static: is for"),
        (DYNAMIC + 'step_s = "1 ms"', "step_s: expected a number"),
        (DYNAMIC + "step_s = -1", "step_s: expected a finite number of 0 or more"),
        (DYNAMIC + "model_error_n = nan", "model_error_n: expected a finite number"),
        (DYNAMIC + "[inputs]\nforce_n = 1.0", "inputs.force_n: unknown key"),
        (DYNAMIC + "[parameters]\nb = 85.0", "parameters.b: expected a table, got 85.0"),
        (DYNAMIC + "[parameters.b]\ntolerance = 1.0", "parameters.b.nominal: expected a number"),
        (DYNAMIC + "[parameters.b]\nnominal = 1.0", "parameters.b.tolerance: expected a number"),
        (DYNAMIC + "[parameters.b]\nnominal = 1.0\ntolerance = -1.0", "tolerance: expected a fin"),
        (DYNAMIC + "[parameters.b]\nnominal = 1.0\nsd = 1.0", "parameters.b.sd: unknown key"),
        (DYNAMIC + '[parameters."a b"]\nnominal = 1.0', "parameters.a b: expected a name of"),
        (DYNAMIC + '[covariance]\nnames = ["x"]\nmatrix = [[1.0]]', "'x' is not a parameter"),
        (DYNAMIC + '[covariance]\nnames = ["x"]\nmatrix = [[1, 2]]', "expected 1 rows of 1 n"),
        (DYNAMIC + '[covariance]\nnames = ["x", "y"]\nmatrix = [[1,2],[2,1]]', "not a covariance"),
        (DYNAMIC + '[covariance]\nnames = "x"\nmatrix = [[1]]', "covariance.names: expect"),
        (DYNAMIC + "[effects.frction]\nx = 1.0", "unknown effect 'frction'"),
        ('kind = "law"\nmodel = "none.toml"', "model: no such file none.toml"),
        ('kind = "law"\nmodel = "chou"', "model: no model 'chou'"),
        ('kind = "law"\nmodel = "chou-hannaford"\nstages = ["pressure"]', "predicts force alone"),
        ('kind = "law"\nmodel = "chou-hannaford"\n[parameters.b]\nnominal = 1', "parameters.b: u"),
        ('kind = "surface"\ntable = "none.csv"', "table: no such file none.csv"),
        ('kind = "predictions"\nstages = ["force"]\ntable = "n.csv"', "table: no such file n.csv"),
        ('kind = "fmu"\nstages = ["force"]\nfile = "none.fmu"', "file: no such file none.fmu"),
    ],
)  # fmt: skip
def test_a_description_is_refused_by_its_key(text: str, expected: str, tmp_path: Path) -> None:
    assert expected in refused(tmp_path, simulator_toml=text, muscle_py=FORCE)


def test_a_description_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(GapError, match="no such file"):
        open_simulator(tmp_path / "none.toml")


def test_a_tolerance_and_a_covariance_must_agree(tmp_path: Path) -> None:
    text = STATIC + '[covariance]\nnames = ["turns"]\nmatrix = [[4.0]]\n'
    made = refused(tmp_path, simulator_toml=text, muscle_py=FORCE)
    assert "parameters.turns.tolerance: is 0.01, but 2 in [covariance]" in made


# Python


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (None, "function: no such file muscle.py"),
        ("def other(): pass", "function: muscle.py has no function 'force'"),
        ("force = 3", "something else than a function 'force'"),
        ("import nothing_like_this", "cannot be imported: ModuleNotFoundError"),
        ("\n1 / 0", "cannot be imported: ZeroDivisionError: division by zero (line 2)"),
        ("def force(:", "cannot be imported: SyntaxError"),
        ("raise SystemExit(3)", "cannot be imported: SystemExit"),
    ],
)
def test_a_function_that_is_not_there(code: str | None, expected: str, tmp_path: Path) -> None:
    files = {"simulator_toml": DYNAMIC} | ({"muscle_py": code} if code is not None else {})
    assert expected in refused(tmp_path, **files)


def test_a_module_that_is_not_there(tmp_path: Path) -> None:
    text = DYNAMIC.replace("muscle.py", "no.such.module")
    assert "no.such.module cannot be imported" in refused(tmp_path, simulator_toml=text)


@pytest.mark.parametrize("static", [False, True])
@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("raise ValueError('two\\nlines')", "raised ValueError: two"),
        ("return 1 / 0", "raised ZeroDivisionError: division by zero (muscle.py, line 2)"),
        ("return [1.0]", "returned an array of shape (1,), expected ("),
        ("return 'abc'", "returned a str, expected an array of numbers"),
        ("return None", "shape (), expected"),
        ("return first(args) * float('nan')", "nan|no finite force"),
        ("raise SystemExit(3)", "raised SystemExit: 3"),
        ("return first(args) * 1j", "returned complex numbers, expected real ones"),
    ],
)
def test_a_function_that_fails(static: bool, body: str, expected: str, tmp_path: Path) -> None:
    code = f"def force(*args):\n    {body}\n\n"
    code += "def first(args):\n    return args[0]['time_s'] if len(args) == 2 else args[0]\n"
    text = DYNAMIC + ("static = true\n" if static else "")
    opened = open_simulator(write(tmp_path, simulator_toml=text, muscle_py=code))
    with pytest.raises(GapError) as error:
        opened.simulate(MEASURED, {})
    made = line(error)
    assert "function muscle.py:force" in made or "function force" in made
    assert "trial t7" in made
    assert any(part in made for part in expected.split("|")), made


def test_what_a_function_prints_stays_off_standard_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = "def force(p, length, parameters):\n    print('called')\n    return 0.1 * p\n"
    text = DYNAMIC + "static = true\n"
    open_simulator(write(tmp_path, simulator_toml=text, muscle_py=code)).simulate(MEASURED, {})
    shown = capsys.readouterr()
    assert "called" not in shown.out
    assert "called" in shown.err


def test_a_function_that_returns_another_channel(tmp_path: Path) -> None:
    code = "def force(inputs, parameters):\n    return {'force': inputs['time_s']}\n"
    opened = open_simulator(write(tmp_path, simulator_toml=DYNAMIC, muscle_py=code))
    with pytest.raises(GapError, match=r"trial t7: returned no force_n, but force"):
        opened.simulate(MEASURED, {})


def test_a_channel_that_was_not_measured_is_named(tmp_path: Path) -> None:
    code = "def force(inputs, parameters):\n    return inputs['supply_kpa']\n"
    text = DYNAMIC.replace('"force"]', '"pressure"]')
    opened = open_simulator(write(tmp_path, simulator_toml=text, muscle_py=code))
    with pytest.raises(GapError, match=r"has no supply_kpa; .* stated under \[inputs\]"):
        opened.simulate(valve_trial(supply=False), {})


def test_settled_points_have_no_time_for_a_function_with_memory(tmp_path: Path) -> None:
    path = write(tmp_path, simulator_toml=DYNAMIC, muscle_py=FORCE)
    rows = trial({"pressure_kpa": ([0], [1.0]), "force_n": ([0], [1.0])}, settled=True)
    with pytest.raises(GapError, match=r"without time \(state static = true"):
        open_simulator(path).simulate(rows, {})


# FMU


def test_a_file_that_is_no_fmu(tmp_path: Path) -> None:
    pytest.importorskip("fmpy")
    made = refused(tmp_path, simulator_toml=FMU, muscle_fmu="not a zip file")
    assert "file: muscle.fmu is no FMU: not a zip file" in made


def test_a_zip_file_that_is_no_fmu(tmp_path: Path) -> None:
    import zipfile

    pytest.importorskip("fmpy")
    with zipfile.ZipFile(tmp_path / "muscle.fmu", "w") as packed:
        packed.writestr("readme.txt", "nothing")
    assert "muscle.fmu cannot be opened" in refused(tmp_path, simulator_toml=FMU)


def test_an_fmu_without_a_binary_for_this_machine(tmp_path: Path) -> None:
    import zipfile

    whole = built_fmu(tmp_path)
    with zipfile.ZipFile(whole) as packed:
        text = packed.read("modelDescription.xml")
    with zipfile.ZipFile(tmp_path / "muscle.fmu", "w") as packed:
        packed.writestr("modelDescription.xml", text)
    assert "muscle.fmu cannot be opened" in refused(tmp_path, simulator_toml=FMU)


def test_without_fmpy_the_line_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built_fmu(tmp_path)
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith("fmpy"):
            raise ImportError(name)
        return real(name, *rest)

    path = write(tmp_path, simulator_toml=FMU)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(GapError, match=r"pip install 'pamrig\[fmu\]'"):
        open_simulator(path)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('name = "p"', 'name = "q"', "variables.pressure_kpa.name: muscle.fmu has no variable 'q'"),
        ('"force"\n\n', '"F"\n\n', "variables.force_n.name: muscle.fmu has no variable 'F'"),
        ("[variables.force_n]", "[variables.forc_n]", "variables.forc_n: unknown key (did you"),
        ('[variables.force_n]\nname = "force"', "", "variables.force_n: is missing"),
        ("factor = 1e3", "factor = 0.0", "variables.pressure_kpa.factor: is 0"),
        ("factor = 1e3", 'factor = "kPa"', "variables.pressure_kpa.factor: expected a number"),
        ('name = "p"', 'name = "pressure"', "the stage force is fed with what was measured"),
        ('"braid_length"', '"braid"', "parameters.braid_length_mm.variable: muscle.fmu has no"),
        ('"braid_length"', '"force"', "'output' in muscle.fmu, expected parameter"),
        ("[parameters.turns]", "[start]\nx = 1.0\n\n[parameters.turns]", "start.x: muscle.fmu has"),
    ],
)
def test_variables_that_the_fmu_does_not_have(
    old: str, new: str, expected: str, tmp_path: Path
) -> None:
    built_fmu(tmp_path)
    assert old in FMU
    assert expected in refused(tmp_path, simulator_toml=FMU.replace(old, new, 1))


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("static", [False, True])
@pytest.mark.parametrize(("fault", "expected"), [(1, "failed at 0 s"), (2, "gave nan as force")])
def test_an_fmu_that_fails_names_the_trial(
    fault: int, expected: str, static: bool, fmi: int, tmp_path: Path
) -> None:
    built_fmu(tmp_path, fmi)
    text = FMU.replace("stages", "static = true\nstages", 1) if static else FMU
    path = write(tmp_path, simulator_toml=text + f"\n[start]\nfault = {fault}\n")
    opened = open_simulator(path)
    for _ in range(2):  # one that failed is loaded anew
        with pytest.raises(GapError) as error:
            opened.simulate(MEASURED, {})
        made = line(error)
        assert "muscle.fmu, trial t7" in made
        assert expected in made


def test_an_output_of_the_chamber_cannot_be_its_input(tmp_path: Path) -> None:
    built_fmu(tmp_path)
    text = CHAMBER_FMU.replace('["pressure"]', '["pressure", "force"]')
    text += '\n[variables.force_n]\nname = "force"\n'
    made = refused(tmp_path, simulator_toml=text)
    assert 'give this stage an FMU in which it is an input: file = { force = "..." }' in made


# Tables


def predictions(folder: Path, table: pd.DataFrame) -> Path:
    folder.mkdir(exist_ok=True)
    table.to_csv(folder / "p.csv", index=False)
    text = 'kind = "predictions"\ntable = "p.csv"\nstages = ["force"]\n'
    return write(folder, simulator_toml=text)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"trial": ["t1"], "time_s": [0.0], "force_n": [1.0]}, "p.csv, trial t7: has no pred"),
        ({"trial": ["t7"], "time_s": [1.4], "force_n": [1.0]}, "is predicted from 1.4 to 1.4 s"),
        ({"trial": ["t7"], "force_n": [1.0]}, "the table has no column time_s"),
        (
            {"trial": ["t7"] * 2, "time_s": [2.0, 0.0], "force_n": [1.0, 1.0]},
            "time_s does not ascend",
        ),
        ({"trial": ["t7"], "time_s": [1.0], "force_n": [None]}, "force_n is empty"),
    ],
)
def test_predictions_that_do_not_cover_what_was_measured(
    columns: dict[str, list[Any]], expected: str, tmp_path: Path
) -> None:
    opened = open_simulator(predictions(tmp_path, pd.DataFrame(columns)))
    with pytest.raises(GapError) as error:
        opened.simulate(MEASURED, {})
    assert expected in line(error)


def test_a_table_of_predictions_with_fewer_settled_points(tmp_path: Path) -> None:
    opened = open_simulator(
        predictions(tmp_path, pd.DataFrame({"trial": ["t7"], "force_n": [1.0]}))
    )
    rows = trial(
        {"pressure_kpa": ([0, 1], [1, 2]), "force_n": ([0, 1], [1, 2])}, "t7", settled=True
    )
    with pytest.raises(GapError, match="has 1 predicted rows, measured are 2"):
        opened.simulate(rows, {})


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"trial": ["t7"], "time_s": [0.0]}, "column force_n: is missing"),
        ({"trial": ["t7"], "force_lbf": [0.0], "force_n": [1.0]}, "force_lbf: is not a column"),
        ({"trial": ["t7"], "force_n": ["x"]}, "'x' is not a number"),
    ],
)
def test_a_table_of_predictions_in_another_form(
    columns: dict[str, list[Any]], expected: str, tmp_path: Path
) -> None:
    path = predictions(tmp_path, pd.DataFrame(columns))
    with pytest.raises(GapError) as error:
        open_simulator(path)
    assert expected in line(error)


@pytest.mark.parametrize(
    ("added", "expected"),
    [
        ("nominal = 1.0\ntolerance = 1.0", "has neither table_high nor table_low"),
        ('nominal = 1.0\ntolerance = 0.0\ntable_high = "p.csv"', "tolerance: is 0, and"),
        ('nominal = 1.0\ntolerance = 1.0\ntable_high = "q.csv"', "table_high: no such file q.csv"),
        ("nominal = 1.0\ntolerance = 1.0\ntable_high = 3", "table_high: expected the name"),
    ],
)
def test_a_parameter_of_a_table(added: str, expected: str, tmp_path: Path) -> None:
    path = predictions(tmp_path, pd.DataFrame({"trial": ["t7"], "force_n": [1.0]}))
    path.write_text(path.read_text() + f"[parameters.b]\n{added}\n")
    with pytest.raises(GapError) as error:
        open_simulator(path)
    assert expected in line(error)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ("0,60,0\n100,60,5\n200,60,9\n", "needs several pressures at several lengths"),
        ("0,60,0\n0,60,1\n100,61,5\n200,62,9\n", "holds a point twice"),
        ("0,60,\n100,61,5\n200,64,9\n", "column force_n: is empty"),
    ],
)
def test_a_surface_that_is_none(rows: str, expected: str, tmp_path: Path) -> None:
    tmp_path.joinpath("s.csv").write_text("pressure_kpa,length_mm,force_n\n" + rows)
    path = write(tmp_path, simulator_toml='kind = "surface"\ntable = "s.csv"\n')
    with pytest.raises(GapError) as error:
        open_simulator(path)
    assert expected in line(error)


def test_a_point_outside_a_surface_is_named_with_its_trial(tmp_path: Path) -> None:
    p, length = (a.ravel() for a in np.meshgrid([0.0, 50.0, 100.0], [55.0, 60.0, 65.0]))
    pd.DataFrame({"pressure_kpa": p, "length_mm": length, "force_n": p * 0.1}).to_csv(
        tmp_path / "s.csv", index=False
    )
    path = write(tmp_path, simulator_toml='kind = "surface"\ntable = "s.csv"\n')
    with pytest.raises(GapError) as error:
        open_simulator(path).simulate(MEASURED, {})
    assert "trial t7: the surface has no finite force at 150 kPa and 60 mm" in line(error)


def test_a_point_where_a_law_has_no_force(tmp_path: Path) -> None:
    """Caldwell's thread is 60 mm at most; longer there is no geometry."""
    path = tmp_path / "model.toml"
    path.write_text(catalogue.to_toml(catalogue.get("caldwell")))
    length = 1.1 * catalogue.get("caldwell").parameter("thread_length").value
    long = trial({"pressure_kpa": ([0, 1], [1, 1]), "force_n": ([0, 1], [1, 1])}, "t7", length)
    with pytest.raises(GapError, match="trial t7: the law caldwell has no finite force at 1 kPa"):
        open_simulator(path).simulate(long, {})


# The commands


def test_a_simulator_that_predicts_no_trial_is_refused(tmp_path: Path) -> None:
    data = read_dataset(settled_set(tmp_path / "data", {}, replicates=1))
    text = DYNAMIC.replace('"force"]', '"pressure"]')
    path = write(tmp_path, simulator_toml=text, muscle_py=FORCE)
    with pytest.raises(GapError, match=r"predicts no trial of .* \(the stage pressure needs"):
        with_simulator(data, path)


def test_effects_of_the_data_and_of_the_simulator_add_up(tmp_path: Path) -> None:
    folder = settled_set(tmp_path / "data", {}, replicates=1)
    (folder / "bench.toml").write_text("[effects.pressure_zero]\noffset_kpa = 1.0\n")
    text = STATIC + "[effects.force_zero]\noffset_n = 0.5\n"
    data = open_data_with(folder, write(tmp_path, simulator_toml=text, muscle_py=FORCE))
    assert set(data.effects.values) == {"pressure_zero", "force_zero"}
    assert data.simulator is not None
    assert open_data_with(folder, None).simulator is None


@pytest.mark.parametrize("command", ["diagnose", "where", "shrink", "next", "report"])
def test_every_command_ends_with_one_line_and_status_2(command: str, tmp_path: Path) -> None:
    folder = settled_set(tmp_path / "data", {}, replicates=1)
    code = "def force(p, length, parameters):\n    return {}['missing']\n"
    path = write(tmp_path, simulator_toml=STATIC, muscle_py=code)
    ran = subprocess.run(
        [sys.executable, "-m", "cli.main", "gap", command, str(folder), "--simulator", str(path)],
        capture_output=True, text=True, timeout=300, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert ran.returncode == 2, ran.stderr
    assert "Traceback" not in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1, ran.stderr
    assert "trial t01: raised KeyError: 'missing' (muscle.py, line 2)" in ran.stderr
