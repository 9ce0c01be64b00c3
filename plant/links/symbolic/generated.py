"""An arm's equations as functions: derived once, cached as Python source on disk.

The source is in `$PAMRIG_CACHE/links`, or `~/.cache/pamrig/links`. Its name depends on the arm and
on the files that derive it, so an outdated file is never used. With a cached source, SymPy is not
needed. If the folder cannot be written, the equations are derived each time. The source is never
executed, only evaluated (see `evaluate`).
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import LinkError
from plant.links.arm import Arm
from plant.links.symbolic.evaluate import equations_of

_DERIVING = ("trigpoly.py", "lagrange.py", "statespace.py", "sourcecode.py", "generated.py")


class GeneratedDynamics:
    """The generated functions of one arm, on arrays (n,) or (batch, n); see `plant.links.dynamics`.

    `functions` are those of the source: arguments are tuples, parameters by default the arm's.
    """

    def __init__(self, arm: Arm, source: str) -> None:
        self.arm = arm
        self.source = source
        self.functions: dict[str, Callable[..., Any]] = {**equations_of(source)}
        self.functions["state_space"] = self._state_space

    def inertia_matrix(self, q: npt.ArrayLike) -> Array:
        """D, (n, n) or (batch, n, n)."""
        rows = self.functions["inertia"](self._columns(q))
        shape = np.shape(q)[:-1]
        return np.stack([self._stacked(row, shape) for row in rows], axis=-2)

    def velocity_torque(self, q: npt.ArrayLike, qd: npt.ArrayLike) -> Array:
        """Coriolis and centrifugal torques h."""
        return self._called("coriolis", q, qd)

    def gravity_torque(self, q: npt.ArrayLike) -> Array:
        """Gravity torques c."""
        return self._called("gravity", q)

    def inverse_dynamics(self, q: npt.ArrayLike, qd: npt.ArrayLike, qdd: npt.ArrayLike) -> Array:
        """Torques for the accelerations `qdd`."""
        return self._called("inverse_dynamics", q, qd, qdd)

    def forward_dynamics(self, q: npt.ArrayLike, qd: npt.ArrayLike, torque: npt.ArrayLike) -> Array:
        """Accelerations for given torques."""
        return self._called("forward_dynamics", q, qd, torque)

    def _called(self, name: str, *given: npt.ArrayLike) -> Array:
        return self._stacked(
            self.functions[name](*map(self._columns, given)), np.shape(given[0])[:-1]
        )

    def _state_space(self, x: Any, tau: Any, p: Any = None) -> tuple[Any, ...]:
        n = self.arm.degrees
        return (*x[n:], *self.functions["forward_dynamics"](x[:n], x[n:], tau, p=p))

    def _columns(self, values: npt.ArrayLike) -> tuple[Any, ...]:
        array = np.asarray(values, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != self.arm.degrees:
            raise LinkError(
                f"arm {self.arm.name!r}: shape {array.shape}; expected ({self.arm.degrees},) or "
                f"(batch, {self.arm.degrees}) for joints {', '.join(self.arm.joints)}"
            )
        return tuple(array.T)

    @staticmethod
    def _stacked(values: Any, shape: tuple[int, ...]) -> Array:
        return np.stack([np.broadcast_to(v, shape) for v in values], axis=-1).astype(np.float64)


@functools.lru_cache(maxsize=32)
def generated(arm: Arm) -> GeneratedDynamics:
    """The generated functions of an arm, from the cache if possible."""
    return GeneratedDynamics(arm, generated_source(arm))


def generated_source(arm: Arm) -> str:
    """Python source of an arm's equations. Raises `LinkError` if SymPy is needed and missing."""
    path = cache_folder() / f"{arm.name}-{_key(arm)}.py"
    kept = _read(path)
    if kept is not None:
        return kept
    require_sympy()
    from plant.links.symbolic.lagrange import derive
    from plant.links.symbolic.sourcecode import as_python

    source = as_python(derive(arm))
    _write(path, source)
    return source


def require_sympy() -> None:
    """Raise `LinkError` with instructions if SymPy is missing."""
    try:
        importlib.metadata.version("sympy")
    except importlib.metadata.PackageNotFoundError:
        raise LinkError(
            "deriving equations needs SymPy, which is not installed: pip install 'pamrig[symbolic]'"
        ) from None


def cache_folder() -> Path:
    """Folder of the cached source."""
    stated = os.environ.get("PAMRIG_CACHE")
    return (Path(stated) if stated else Path.home() / ".cache" / "pamrig") / "links"


def _key(arm: Arm) -> str:
    digest = hashlib.sha256(repr(arm).encode())
    for name in _DERIVING:
        digest.update(resources.files("plant").joinpath("links", "symbolic", name).read_bytes())
    return digest.hexdigest()[:16]


def _sum(source: str) -> str:
    return f"# sha256 {hashlib.sha256(source.encode()).hexdigest()}\n"


def _read(path: Path) -> str | None:
    """Source from the cache, or None if missing or damaged."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    source, mark, _ = text.rpartition("# sha256 ")
    return source if mark and text == source + _sum(source) else None


def _write(path: Path, source: str) -> None:
    """Write atomically, because another process may read the file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(source + _sum(source))
        os.replace(name, path)
    except OSError:
        return
