"""Each format, read against values that the format's own library wrote."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from mcap.writer import Writer
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from gap.data.reader import read_dataset
from gap.errors import GapError
from gap.mapping.formats.opened import open_source
from gap.mapping.formats.text import TextLayout
from import_sets import imported

TIME_S = np.array([0.0, 0.25, 0.75, 1.0])
BAR = np.array([1.0, 2.5, 2.25, -0.5])
NEWTON = np.array([3.0, -1.5, 0.0, 12.0])

BODY = """
[channels.pressure_kpa]
column = {pressure}
unit = "bar"
reference = "gauge"

[channels.force_n]
column = {force}
unit = "N"
"""


def check(folder: Path, head: str, pressure: str = '"p"', force: str = '"f"') -> None:
    imported(folder, head + BODY.format(pressure=pressure, force=force))
    (trial,) = read_dataset(folder / "out").trials
    for name, value in (("pressure_kpa", BAR * 100.0), ("force_n", NEWTON)):
        np.testing.assert_allclose(trial[name].value, value, rtol=0, atol=1e-9)
        np.testing.assert_allclose(trial[name].time_s, TIME_S, rtol=0, atol=1e-12)


def table() -> pd.DataFrame:
    return pd.DataFrame({"t": TIME_S, "p": BAR, "f": NEWTON})


@pytest.mark.parametrize(
    ("write", "keys"),
    [
        ({"sep": ","}, ""),
        ({"sep": ";", "decimal": ","}, 'delimiter = "semicolon"\ndecimal = "comma"'),
        ({"sep": "\t"}, 'delimiter = "tab"'),
        ({"sep": " "}, 'delimiter = "space"'),
        ({"sep": "|"}, 'delimiter = "bar"'),
        ({"sep": ",", "encoding": "utf-16"}, 'encoding = "utf-16"'),
        ({"sep": ",", "lineterminator": "\r\n"}, ""),
        ({"sep": ",", "quoting": 1}, ""),
    ],
)
def test_csv_as_pandas_writes_it(write: dict[str, Any], keys: str, tmp_path: Path) -> None:
    table().to_csv(tmp_path / "a.csv", index=False, **write)
    check(tmp_path, f'[source]\nfiles = "a.csv"\n{keys}\n[time]\ncolumn = "t"\nunit = "s"\n')


def test_csv_without_header_with_comments_and_a_preamble(tmp_path: Path) -> None:
    rows = table().to_csv(index=False, header=False).splitlines()
    text = ["made by a logger", "serial 12", rows[0], "% paused", *rows[1:], ""]
    (tmp_path / "a.txt").write_text("\n".join(text))
    head = '[source]\nfiles = "a.txt"\nheader = false\nskip_lines = 2\ncomment = "%"\n'
    check(tmp_path, head + '[time]\ncolumn = 1\nunit = "s"\n', "2", "3")


def test_csv_with_a_row_of_units_below_the_header(tmp_path: Path) -> None:
    header, *rows = table().to_csv(index=False).splitlines()
    (tmp_path / "a.csv").write_text("\n".join([header, "s,bar,N", *rows]) + "\n")
    head = '[source]\nfiles = "a.csv"\nskip_after_header = 1\n'
    check(tmp_path, head + '[time]\ncolumn = "t"\nunit = "s"\n')


def test_parquet(tmp_path: Path) -> None:
    table().to_parquet(tmp_path / "a.parquet")
    check(tmp_path, '[source]\nfiles = "a.parquet"\n[time]\ncolumn = "t"\nunit = "s"\n')


def test_parquet_with_dates(tmp_path: Path) -> None:
    dates = pd.Timestamp("2026-03-01 10:00", tz="Europe/Berlin") + pd.to_timedelta(TIME_S, "s")
    table().assign(t=dates).to_parquet(tmp_path / "a.parquet")
    check(tmp_path, '[source]\nfiles = "a.parquet"\n[time]\ncolumn = "t"\nunit = "ISO"\n')
    begin = read_dataset(tmp_path / "out").trials[0].start_s
    assert begin == pd.Timestamp("2026-03-01 09:00", tz="UTC").timestamp()


def test_mat_of_version_5_with_a_struct_and_a_matrix(tmp_path: Path) -> None:
    log = {"t": TIME_S, "pf": np.column_stack([BAR, NEWTON])}
    savemat(tmp_path / "a.mat", {"log": log}, do_compression=True)
    head = '[source]\nfiles = "a.mat"\n[time]\ncolumn = "log.t"\nunit = "s"\n'
    check(tmp_path, head, '"log.pf[1]"', '"log.pf[2]"')


def test_mat_of_version_7_3_is_hdf5_with_columns_first(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["t"] = TIME_S[None, :]
        file["log/pf"] = np.column_stack([BAR, NEWTON]).T
    head = '[source]\nfiles = "a.mat"\n[time]\ncolumn = "t"\nunit = "s"\n'
    check(tmp_path, head, '"log/pf[1]"', '"log/pf[2]"')


def test_hdf5_with_groups_compounds_and_compression(tmp_path: Path) -> None:
    rows = np.array(list(zip(TIME_S, BAR, strict=True)), dtype=[("t", "f8"), ("p", "f4")])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("run/table", data=rows, compression="gzip")
        file["run/f"] = NEWTON
    head = '[source]\nfiles = "a.h5"\n[time]\ncolumn = "run/table/t"\nunit = "s"\n'
    check(tmp_path, head, '"run/table/p"', '"run/f"')


def tdms(path: Path, channels: dict[str, Any], **properties: Any) -> None:
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [ChannelObject("g", name, value, properties) for name, value in channels.items()]
        )


def test_tdms_with_a_column_of_times(tmp_path: Path) -> None:
    tdms(tmp_path / "a.tdms", {"t": TIME_S, "p": BAR, "f": NEWTON})
    head = '[source]\nfiles = "a.tdms"\n[time]\ncolumn = "g/t"\nunit = "s"\n'
    check(tmp_path, head, '"g/p"', '"g/f"')


def test_tdms_with_the_times_of_its_waveforms(tmp_path: Path) -> None:
    start = np.datetime64("2026-03-01T09:00:00")
    tdms(tmp_path / "a.tdms", {"p": BAR, "f": NEWTON}, wf_increment=0.5, wf_start_time=start)
    imported(
        tmp_path,
        '[source]\nfiles = "a.tdms"\n[time]\nown = true\n'
        + BODY.format(pressure='"g/p"', force='"g/f"'),
    )
    (trial,) = read_dataset(tmp_path / "out").trials
    assert trial["force_n"].time_s.tolist() == [0.0, 0.5, 1.0, 1.5]
    assert trial.start_s == pd.Timestamp("2026-03-01 09:00", tz="UTC").timestamp()


def mcap(path: Path, topics: dict[str, list[tuple[int, Any]]], encoding: str = "json") -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        for topic, messages in topics.items():
            channel = writer.register_channel(topic, encoding, schema)
            for ns, message in messages:
                data = message if isinstance(message, bytes) else json.dumps(message).encode()
                writer.add_message(channel, ns, data, ns)
        writer.finish()


def test_mcap_with_json_messages_of_two_topics(tmp_path: Path) -> None:
    at = [1_770_000_000_000_000_000 + round(t * 1e9) for t in TIME_S]
    pressures = [(ns, {"gauge": {"bar": p}}) for ns, p in zip(at, BAR.tolist(), strict=True)]
    forces = [(ns, {"value": [0, f]}) for ns, f in zip(at, NEWTON.tolist(), strict=True)]
    mcap(tmp_path / "a.mcap", {"/air": pressures, "/cell": forces})
    check(tmp_path, '[source]\nfiles = "a.mcap"\n', '"/air:gauge.bar"', '"/cell:value.1"')
    assert read_dataset(tmp_path / "out").trials[0].start_s == 1_770_000_000.0


# ---------------------------------------------------------------------------- refused files


def columns(path: Path, name: str) -> Any:
    return open_source(path, "", TextLayout()).column(name)


def test_objects_in_a_mat_file_are_no_data(tmp_path: Path) -> None:
    cells = np.empty(2, dtype=object)
    cells[:] = [np.array([1.0]), np.array([2.0])]
    savemat(tmp_path / "a.mat", {"c": cells})
    with pytest.raises(GapError, match=r"a\.mat, column c: holds objects"):
        columns(tmp_path / "a.mat", "c")


def test_a_link_into_another_file_is_not_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["x"] = BAR
    layout = h5py.VirtualLayout(shape=(4,), dtype="f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "b.h5"), "x", shape=(4,))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["link"] = h5py.ExternalLink("b.h5", "/x")
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("raw", (4,), "f8", external=[(str(tmp_path / "c.bin"), 0, 32)])
    with pytest.raises(GapError, match=r"link into another file \(b\.h5\)"):
        columns(tmp_path / "a.h5", "link")
    for name in ("virtual", "raw"):
        with pytest.raises(GapError, match="stored in another file"):
            columns(tmp_path / "a.h5", name)


def test_messages_that_are_not_json_are_refused(tmp_path: Path) -> None:
    mcap(tmp_path / "a.mcap", {"/x": [(1, b"\x00\x01")]}, "cdr")
    with pytest.raises(GapError, match=r"encoded as 'cdr'; only JSON"):
        columns(tmp_path / "a.mcap", "/x:y")
    mcap(tmp_path / "b.mcap", {"/x": [(1, b"{")]})
    with pytest.raises(GapError, match=r"b\.mcap, topic /x: cannot be read"):
        columns(tmp_path / "b.mcap", "/x:y")
    mcap(tmp_path / "c.mcap", {"/x": [(1, {"y": 1}), (2, {"z": 1})]})
    with pytest.raises(GapError, match=r"message 2: has no field 'y'"):
        columns(tmp_path / "c.mcap", "/x:y")


@pytest.mark.parametrize("suffix", ["parquet", "mat", "h5", "tdms", "mcap", "csv"])
def test_what_is_not_of_the_format_is_named(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(b"\xff\xfe\x00 this is nothing \x89" * 40)
    with pytest.raises(GapError, match=rf"a\.{suffix}") as caught:
        columns(path, "x")
    assert "\n" not in str(caught.value)
    path.write_bytes(b"")
    with pytest.raises(GapError, match="is empty"):
        columns(path, "x")


@pytest.mark.parametrize(
    ("suffix", "package"), [("h5", "h5py"), ("tdms", "npTDMS"), ("mcap", "mcap")]
)
def test_a_missing_library_is_named_with_the_extra(
    suffix: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(b"x")
    for module in ("h5py", "nptdms", "mcap", "mcap.reader"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(GapError, match=rf"needs the package {package} \(pip install 'pamrig\["):
        open_source(path, "", TextLayout())


def test_a_missing_column_lists_those_that_are_there(tmp_path: Path) -> None:
    table().to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(GapError, match=r"a\.csv, column q: is missing \(there are: t, p, f\)"):
        columns(tmp_path / "a.csv", "q")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/p"] = BAR
    with pytest.raises(GapError, match=r"a\.h5, column q: is missing \(there are: run/p\)"):
        columns(tmp_path / "a.h5", "q")
