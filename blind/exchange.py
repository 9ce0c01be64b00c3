"""Write a recorded set as a data folder: trials.csv, samples.parquet or .csv, bench.toml."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from blind.recording import Recorded


def write(recorded: Recorded, folder: Path, as_csv: bool = False) -> None:
    """Write the folder (made if absent). Units stand in the column names."""
    folder.mkdir(parents=True, exist_ok=True)
    recorded.trials.to_csv(folder / "trials.csv", index=False)
    if as_csv:
        recorded.samples.to_csv(folder / "samples.csv", index=False)
    else:
        arrays, names = [], []
        for name in recorded.samples.columns:
            column = recorded.samples[name]
            if not pd.api.types.is_numeric_dtype(column):
                arrays.append(pa.array(column.tolist(), type=pa.string()))
            else:
                values = column.to_numpy(dtype=float)
                arrays.append(pa.array(values, mask=np.isnan(values)))
            names.append(name)
        pq.write_table(pa.table(dict(zip(names, arrays, strict=True))), folder / "samples.parquet")
    if recorded.bench:
        lines = [f"{key} = {value}" for key, value in sorted(recorded.bench.items())]
        (folder / "bench.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
