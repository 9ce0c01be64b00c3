"""What decides a diagnosis, as one number: data, simulator, catalogue and program."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable
from functools import cache
from importlib import metadata, resources
from importlib.resources.abc import Traversable
from typing import Any

import numpy as np

from gap.data.dataset import DataSet
from gap.data.simulator import ExternalSimulator
from gap.data.trial import Trial
from gap.simulators.external import External

_FORM = "1"
"""Counts changes of the form in which diagnoses are kept."""
_PROGRAM = ("gap", "plant")
_SUFFIXES = (".py", ".toml", ".npz", ".csv")
_LIBRARIES = ("numpy", "scipy", "numba")


def fingerprint(data: DataSet, struck: Iterable[str]) -> str | None:
    """SHA-256 of all that a diagnosis depends on; None where that is not known.

    A simulator is known by its description and by the files that the description names. What a
    program imports or reads beside them is not known.
    """
    digest = hashlib.sha256()
    _add(digest, _FORM, program(), *sorted(struck))
    for trial in data.trials:
        _add_trial(digest, trial)
    _add(digest, data.constants, data.effects, data.corrections, data.notes)
    _add(digest, sorted(data.calibration.items()), data.standards)
    if data.simulator is not None and not _add_simulator(digest, data.simulator):
        return None
    return digest.hexdigest()


def _add(digest: Any, *values: object) -> None:
    """Values by their text, which tells any two numbers apart; each with its length."""
    for value in values:
        text = repr(value).encode()
        digest.update(b"%d:" % len(text) + text)


def _add_trial(digest: Any, trial: Trial) -> None:
    for field in dataclasses.fields(trial):
        value = getattr(trial, field.name)
        if field.name == "channels":
            for name, channel in sorted(value.items()):
                _add(digest, name)
                _add_array(digest, channel.time_s)
                _add_array(digest, channel.value)
        elif isinstance(value, np.ndarray):
            _add_array(digest, value)
        else:
            _add(digest, field.name, value)


def _add_array(digest: Any, values: Any) -> None:
    _add(digest, values.dtype.str, values.shape)
    digest.update(np.ascontiguousarray(values).data)


def _add_simulator(digest: Any, simulator: ExternalSimulator) -> bool:
    """Take in a simulator; False where nothing is known of where its predictions come from."""
    if not isinstance(simulator, External):
        return False
    _add(digest, simulator.about.kind, simulator.about.table, simulator.parameters)
    try:
        for path in simulator.sources():
            _add(digest, path.name, hashlib.sha256(path.read_bytes()).hexdigest())
    except OSError:
        return False
    return True


@cache
def program() -> str:
    """SHA-256 of the sources of this program and the versions of what it computes with."""
    digest = hashlib.sha256()
    _add(digest, *(metadata.version(name) for name in _LIBRARIES))
    for name in _PROGRAM:
        _add_folder(digest, resources.files(name), name)
    return digest.hexdigest()


def _add_folder(digest: Any, place: Traversable, name: str) -> None:
    for inner in sorted(place.iterdir(), key=lambda one: one.name):
        if inner.is_dir():
            _add_folder(digest, inner, f"{name}/{inner.name}")
        elif inner.name.endswith(_SUFFIXES):
            _add(digest, f"{name}/{inner.name}")
            digest.update(inner.read_bytes())
