"""What a test protocol is to everything that runs, shows, reduces and reports tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from typing import TYPE_CHECKING, Any, Protocol

from analysis.findings.findings import Analysis
from daq.errors import ConfigError
from rigs.rigfile.acceptance import Acceptance
from rigs.steps.custom_step import Steps

if TYPE_CHECKING:
    from daq.store.run import Run
    from rigs.rigfile.config import RigConfig


def plain(value: Any) -> Any:
    """Parameters as they stand in run.json: lists for tuples, tables for what has fields."""
    if isinstance(value, tuple):
        return list(value)
    if hasattr(value, "as_dict"):
        return value.as_dict()
    return dict(vars(value)) if is_dataclass(value) else value


class Parameters:
    """Base of the parameters of a protocol, which are frozen dataclasses."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {key: plain(value) for key, value in vars(self).items()}


@dataclass(frozen=True, kw_only=True)
class ProtocolParameters(Parameters):
    """Base of the parameters of a test.

    Attributes:
        acceptance: limits that the report judges the results by, where the file states some.
    """

    acceptance: Acceptance | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json; without limits there is no ``acceptance``."""
        out = super().as_dict()
        return out if self.acceptance else {k: v for k, v in out.items() if k != "acceptance"}


class Plan(Protocol):
    """The parameters of one test, as read from its protocol file."""

    @property
    def name(self) -> str:
        """Name of the test, as its file says."""
        ...

    @property
    def frames(self) -> int:
        """Pictures at a point; 0 for a test without the camera."""
        ...

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        ...

    def steps(self) -> Steps:
        """The method, top to bottom; a new generator each time."""
        ...


@dataclass(frozen=True)
class Procedure:
    """One kind of test: how it is read and run, and how its runs are analysed.

    Attributes:
        analysis: name, title, reduction, findings and panels.
        read: protocol file (path or shipped name) and rig to checked parameters; refuses,
            with file and key, what the rig cannot do.
        firmware: settings of the controller that this test needs, over those of the rig.
        on_joint: it tests a joint between two muscles, not a muscle.
        open_ended: its steps come as it runs, so that they cannot be walked through beforehand;
            one of them arms the bench.
        done: what the continuation of a run has to know beside its whole trials, for a test that
            goes on within a trial; it is added to ``continues`` of run.json.
        rest: steps of such a continuation, from its plan and ``continues``.
        stored_points: points of a plan that are stored at full rate, where not all are.
    """

    analysis: Analysis
    read: Callable[[str, RigConfig], Plan]
    firmware: Mapping[str, int] = field(default_factory=dict)
    open_ended: bool = False
    on_joint: bool = False
    done: Callable[[Run], Mapping[str, Any]] | None = None
    rest: Callable[[Any, Mapping[str, Any]], Steps] | None = None
    stored_points: Callable[[Any], int] | None = None

    def check(self, config: RigConfig) -> None:
        """Refuse a rig of the other kind.

        Raises:
            ConfigError: the rig has a joint and the test is of a muscle, or the other way round.
        """
        if self.on_joint and config.joint is None:
            raise ConfigError(
                config.source,
                f"has no [joint], which {self.name} tests",
                "use the rig virtual-joint, or see docs/use/joint.md",
            )
        if config.joint is not None and not self.on_joint:
            raise ConfigError(
                config.source,
                f"holds two muscles on a joint; {self.name} tests one muscle or valve",
                "use joint-static or joint-step, or a rig without [joint]",
            )

    @property
    def name(self) -> str:
        """Its command, and ``protocol`` in its files and records."""
        return self.analysis.name
