"""QCoDeS as its documentation shows: a Measurement, add_result, a data set in SQLite."""

from __future__ import annotations

import importlib.metadata
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
from qcodes.dataset import (
    Measurement,
    initialise_or_create_database_at,
    load_by_id,
    load_or_create_experiment,
)
from source import BLOCK, CHANNELS, blocks, checked, rows, serve


def record(job: dict[str, Any]) -> int:
    initialise_or_create_database_at(str(Path(job["folder"]) / "bench.db"))
    measurement = Measurement(exp=load_or_create_experiment("bench", "muscle"))
    if job["write_period_s"] is not None:
        measurement.write_period = job["write_period_s"]
    kind = "array" if job["arrays"] else "numeric"
    measurement.register_custom_parameter("row", paramtype=kind)
    for name in CHANNELS:
        measurement.register_custom_parameter(name, paramtype=kind, setpoints=("row",))
    count = 0
    with measurement.run() as saver:
        if job["arrays"]:
            for first, block in blocks(job):
                saver.add_result(
                    ("row", np.arange(first, first + BLOCK)),
                    *((name, block[:, k]) for k, name in enumerate(CHANNELS)),
                )
                count = first + BLOCK
        else:
            for number, values in rows(job):
                saver.add_result(("row", number), *zip(CHANNELS, values, strict=True))
                count = number + 1
    return count


def read(job: dict[str, Any]) -> dict[str, int]:
    path = Path(job["folder"]) / "bench.db"
    initialise_or_create_database_at(str(path))
    found = load_by_id(1).get_parameter_data()
    if not found or "row" not in found.get(CHANNELS[0], {}):
        return {"rows": 0, "wrong": 0}
    channels = [np.ravel(found[name][name]) for name in CHANNELS]
    return checked(np.ravel(found[CHANNELS[0]]["row"]), np.column_stack(channels))


if __name__ == "__main__":
    connection = sqlite3.connect(":memory:")
    level = connection.execute("PRAGMA synchronous").fetchone()[0]
    serve(
        record,
        read,
        f"QCoDeS {importlib.metadata.version('qcodes')} "
        f"(SQLite {sqlite3.sqlite_version}, synchronous {level})",
    )
