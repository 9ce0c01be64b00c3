"""The diagnosis as the blind check calls it: a folder on disk in, a verdict out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.verdict import Verdict


def verdict_of_folder(folder: Path, without: Sequence[str] = ()) -> Verdict:
    """The verdict of `pamrig gap diagnose FOLDER --without ...`."""
    return diagnose(read_dataset(folder), without)
