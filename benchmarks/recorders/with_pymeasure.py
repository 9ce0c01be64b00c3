"""PyMeasure as its documentation shows: a Procedure that emits, a Worker, Results in a CSV file."""

from __future__ import annotations

import importlib.metadata
import time
from pathlib import Path
from typing import Any

import numpy as np
from pymeasure.experiment import Procedure, Results, Worker
from source import CHANNELS, checked, rows, serve, synced

WAITING = 1000  # rows in its queue, which knows no bound: a flat-out feed must wait for it


class Bench(Procedure):
    DATA_COLUMNS = ["row", *CHANNELS]  # noqa: RUF012  its own form
    job: dict[str, Any]
    worker: Any
    count = 0

    def execute(self) -> None:
        queue = self.worker.recorder_queue
        for number, values in rows(self.job):
            self.emit("results", {"row": number, **dict(zip(CHANNELS, values, strict=True))})
            self.count = number + 1
            if not self.count % WAITING:
                while queue.qsize() > WAITING:
                    time.sleep(1e-3)


def record(job: dict[str, Any]) -> int:
    path = Path(job["folder"]) / "bench.csv"
    procedure = Bench()
    procedure.job = job
    worker = procedure.worker = Worker(Results(procedure, str(path)))
    with synced(lambda: path, job["fsync"]):
        worker.start()
        worker.join(timeout=600)
    if procedure.status != Procedure.FINISHED:
        raise RuntimeError(f"PyMeasure's procedure ended with status {procedure.status}")
    return procedure.count


def read(job: dict[str, Any]) -> dict[str, int]:
    data = Results.load(str(Path(job["folder"]) / "bench.csv"), Bench).data
    data = data[np.isfinite(data.to_numpy(dtype=float)).all(axis=1)]  # a torn last line
    return checked(data["row"].to_numpy(), data[CHANNELS].to_numpy())


if __name__ == "__main__":
    serve(record, read, f"PyMeasure {importlib.metadata.version('pymeasure')}")
