"""Draw a secret with which the rig's own protections let its tests run.

A bench whose sensor reads 24 kPa when vented, or lags so far that its protection takes the lag for
a valve that does not shut, is refused before anything is measured, as a real one would be: there is
a fault to be found and no gap to be explained. Such a secret is drawn again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from blind.live import Secret
from cli.investigate.survey import FIRST_DIAGNOSIS_AFTER, battery, protocol_text
from daq.clock import VirtualClock
from daq.errors import ConfigError
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig
from rigs.virtual.withheld.bench import WithheldBench, draw

TRIES = 20
_OTHER = 1 << 96
"""What a draw that is made again adds to the entropy: more than the system's own can be."""


def draw_runnable(
    config: RigConfig,
    effects: Sequence[str] = (),
    entropy: int | None = None,
    report: Callable[[str], None] = lambda text: None,
) -> Secret:
    """As :func:`rigs.virtual.withheld.bench.draw`, drawn again where the bench could not be run.

    `tell` takes a line for each secret that is put back; it does not name the effect.

    Raises:
        ConfigError: as `draw`, or no secret in twenty lets the rig run.
    """
    for attempt in range(TRIES):
        secret = draw(config, effects, None if entropy is None else entropy + attempt * _OTHER)
        refused = refusal(config, secret)
        if refused is None:
            return secret
        report("the rig's protections refuse this one; drawing another")
    raise ConfigError(
        config.source, f"refuses to run with each of {TRIES} drawn effects: {refused}"
    )


def refusal(config: RigConfig, secret: Secret) -> str | None:
    """What ends the first tests on a bench with this secret; None if nothing."""
    for test in battery(config)[:FIRST_DIAGNOSIS_AFTER]:
        with TemporaryDirectory() as scratch:
            path = Path(scratch) / f"{test.protocol}.toml"
            path.write_text(protocol_text(test, config), encoding="utf-8")
            kind = procedure(test.protocol)
            bench = WithheldBench(config, secret, VirtualClock())
            plan = kind.read(str(path), config)
            out = Path(scratch) / "runs"
            result = run_protocol(kind, config, plan, out, bench=bench)
        if result.outcome != "clean":
            return str(result.error)
    return None
