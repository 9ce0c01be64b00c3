"""An archive for publication: complete, described, checked by sums, and honest about its origin."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import shutil
import zipfile
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.formats.archive import Publication, read_author, read_licence, write_archive
from analysis.formats.columns import described
from bench_runs import quick, run_isometric
from daq.errors import ConfigError
from daq.store.run import Run, open_run
from rigs.rigfile.config import load_rig

PERSON = "Josiah Carberry, 0000-0002-1825-0097, Brown University"
"""The person whose ORCID ORCID itself gives as an example."""
ABOUT = Publication(
    "Isometric test of a muscle", "CC-BY-4.0", (read_author(PERSON),), published=date(2026, 1, 31)
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    config = load_rig("virtual")
    plan = quick(config, lengths_mm=(57.0,), pressures_kpa=(100.0, 250.0), repeats=1)
    return open_run(run_isometric(config, plan, tmp_path_factory.mktemp("runs")).folder)


@pytest.fixture(scope="module")
def archive(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("archive") / "data.zip"
    assert write_archive([run], ABOUT, out) == []
    return out


def entities(archive: Path) -> dict[str, dict[str, Any]]:
    with zipfile.ZipFile(archive) as file:
        graph = json.loads(file.read("ro-crate-metadata.json"))["@graph"]
    return {entity["@id"]: entity for entity in graph}


def test_every_file_is_described_with_its_size_and_sum(archive: Path) -> None:
    described_files = {k: e for k, e in entities(archive).items() if e["@type"] == "File"}
    with zipfile.ZipFile(archive) as file:
        names = {n for n in file.namelist() if not n.endswith("/")}
        own = {"ro-crate-metadata.json", "ro-crate-preview.html"}
        assert names - own == set(described_files)
        for name, entity in described_files.items():
            data = file.read(name)
            assert entity["contentSize"] == str(len(data))
            assert entity["sha256"] == hashlib.sha256(data).hexdigest()
        lines = file.read("manifest-sha256.txt").decode().splitlines()
    sums = dict(reversed(line.split("  ", 1)) for line in lines)
    assert sums.keys() == described_files.keys() - {"manifest-sha256.txt"}
    assert all(described_files[name]["sha256"] == digest for name, digest in sums.items())


def test_every_reference_leads_somewhere(archive: Path) -> None:
    there = entities(archive)

    def references(value: Any) -> list[str]:
        if isinstance(value, dict):
            return [value["@id"]] if set(value) == {"@id"} else references([*value.values()])
        return [r for inner in value for r in references(inner)] if isinstance(value, list) else []

    outside = {"https://w3id.org/ro/crate/1.1"}
    missing = {r for e in there.values() for r in references(e)} - there.keys() - outside
    assert not missing


def test_the_raw_record_is_in_it_byte_for_byte(archive: Path, run: Run) -> None:
    with zipfile.ZipFile(archive) as file:
        inside = {
            name.split("/record/")[1]: file.read(name)
            for name in file.namelist()
            if "/record/" in name
        }
    there = {str(p.relative_to(run.folder)): p for p in run.folder.rglob("*") if p.is_file()}
    raw = {name: path.read_bytes() for name, path in there.items() if "derived" not in name}
    assert inside == raw


def test_columns_have_meaning_unit_and_uncertainty(archive: Path, run: Run) -> None:
    there = entities(archive)
    table = there[f"{run.run_id}/table.csv"]
    with zipfile.ZipFile(archive) as file:
        header = next(csv.reader(io.StringIO(file.read(table["@id"]).decode())))
    named = [there[v["@id"]] for v in table["variableMeasured"]]
    assert [v["name"] for v in named] == header
    force = there["#column-force_n"]
    assert (force["unitText"], force["unitCode"]) == ("N", "http://qudt.org/vocab/unit/N")
    assert "u_force_n" in force["measurementTechnique"]
    assert "part of the calibration" in there["#column-u_force_n_cal"]["description"]
    for key, variable in there.items():
        if key.startswith("#column-"):
            assert " " in variable["description"] or variable["name"] in (
                "temperature_c", "set_temperature_c",
            ), variable  # fmt: skip


@pytest.mark.parametrize(
    ("name", "unit"),
    [("pressure_kpa", "kPa"), ("time_s", "s"), ("u_length_mm_noise", "mm"), ("mass_kg", "kg"),
     ("set_temperature_c", "degC"), ("velocity_m_s", "m/s"), ("on_ms", "ms"), ("boot", ""),
     ("n_samples", ""), ("humidity_percent", "%")],
)  # fmt: skip
def test_the_unit_of_a_column_comes_from_the_end_of_its_name(name: str, unit: str) -> None:
    (column,) = described([name])
    assert column.unit == unit


def test_a_simulated_run_says_so(archive: Path, run: Run) -> None:
    assert f"SIMULATED, not measured: {run.run_id}" in entities(archive)["./"]["description"]


def test_what_a_check_found_stands_in_the_archive(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / run.run_id
    shutil.copytree(run.folder, folder)
    (folder / "final.json").unlink()
    out = tmp_path / "data.zip"
    found = write_archive([open_run(folder)], ABOUT, out, record=False)
    assert found
    assert found[0] in entities(out)["./"]["description"]
    with zipfile.ZipFile(out) as file:
        assert not [n for n in file.namelist() if "/record/" in n]


def test_an_existing_file_and_a_run_named_twice_are_refused(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "data.zip"
    with pytest.raises(ConfigError, match="named twice"):
        write_archive([run, run], ABOUT, out)
    out.write_text("mine")
    with pytest.raises(ConfigError, match="exists already"):
        write_archive([run], ABOUT, out)
    assert out.read_text() == "mine"
    assert os.listdir(tmp_path) == ["data.zip"]


def test_stopped_midway_nothing_is_left(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("analysis.formats.export.write_csv", stop)
    with pytest.raises(KeyboardInterrupt):
        write_archive([run], ABOUT, tmp_path / "data.zip")
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(
    "text", ["", "  , 0000-0002-1825-0097", "A B, 0000-0002-1825-0098", "A B, 0000-0002-1825"]
)
def test_an_author_without_a_name_or_with_a_wrong_orcid_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--author"):
        read_author(text)


@pytest.mark.parametrize(
    "text", ["0000-0002-1825-0097", "0000-0001-5109-3700", "0000-0002-1694-233X"]
)
def test_published_examples_of_orcids_are_taken(text: str) -> None:
    """The examples of ORCID's page on the structure of its identifier."""
    assert read_author(f"A B, https://orcid.org/{text}").orcid == text


@given(st.integers(0, 15), st.integers(1, 9))
def test_a_wrong_digit_of_an_orcid_is_found(place: int, more: int) -> None:
    digits = list("0000000218250097")
    digits[place] = str((int(digits[place]) + more) % 10)
    text = "-".join("".join(digits[k : k + 4]) for k in range(0, 16, 4))
    with pytest.raises(ConfigError):
        read_author(f"A B, {text}")


@pytest.mark.parametrize("text", ["", "free to use", "CC BY", "file:terms.txt"])
def test_a_licence_is_an_spdx_identifier_or_an_address(text: str) -> None:
    assert read_licence("CC0-1.0") == "CC0-1.0"
    with pytest.raises(ConfigError, match="--licence"):
        read_licence(text)


@pytest.mark.campaign
def test_the_validator_of_the_standard_takes_it(archive: Path) -> None:
    """Needs `pip install roc-validator` and a network (it reads the JSON-LD context)."""
    models = pytest.importorskip("rocrate_validator.models")
    from rocrate_validator import services

    settings = models.ValidationSettings(
        rocrate_uri=str(archive), profile_identifier="ro-crate-1.1",
        requirement_severity=models.Severity.REQUIRED,
    )  # fmt: skip
    assert [issue.message for issue in services.validate(settings).get_issues()] == []
