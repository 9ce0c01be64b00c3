"""Draw a hidden effect with which the rig can run its tests.

Some effects trip the rig's protections before anything is measured, for example a sensor that reads
24 kPa when vented, or a lag that looks like a valve that does not close. On a real bench this is a
fault to repair, not a gap to explain. Such an effect is rejected and another one is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from blind.live import Secret
from cli.investigate.config import INVESTIGATION
from cli.investigate.survey import battery, protocol_text
from daq.clock import VirtualClock
from daq.errors import ConfigError
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig
from rigs.virtual.withheld.bench import WithheldBench, draw

TRIES = 20
_OTHER = 1 << 96
"""Added to the entropy for each further draw; larger than the system's own entropy."""


def draw_runnable(
    config: RigConfig,
    effects: Sequence[str] = (),
    entropy: int | None = None,
    report: Callable[[str], None] = lambda text: None,
    held_out: bool = False,
) -> Secret:
    """As :func:`rigs.virtual.withheld.bench.draw`, repeated until the bench can run its tests.

    `report` is called with a line for each rejected secret; the line does not name the effect.

    Raises:
        ConfigError: as `draw`, or the rig rejects all of `TRIES` secrets.
    """
    for attempt in range(TRIES):
        seed = None if entropy is None else entropy + attempt * _OTHER
        secret = draw(config, effects, seed, held_out)
        refused = refusal(config, secret)
        if refused is None:
            return secret
        report("the rig's protections reject this effect; drawing another one")
    raise ConfigError(config.source, f"rejects each of {TRIES} drawn effects: {refused}")


def refusal(config: RigConfig, secret: Secret) -> str | None:
    """The error that ends one of the first tests on a bench with this secret; None if they run."""
    for test in battery(config)[: INVESTIGATION.first_diagnosis_after]:
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
