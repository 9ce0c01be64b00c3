"""A rig for a notebook or a script: ``with pamrig.open_rig("bench.toml") as rig: ...``."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from daq.errors import (
    ConfigError,
    DeviceError,
    DeviceTimeout,
    LinkLost,
    PamrigError,
    PortError,
    RecordError,
)
from rigs.interactive.inbox import CLOSED, receive, receive_tables, send

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

START_S = 120.0
CLOSE_S = 60.0
ERRORS = {
    error.__name__: error
    for error in (ConfigError, DeviceError, DeviceTimeout, LinkLost, PortError, RecordError)
}


class Stretch:
    """A recorded stretch of time.

    Attributes:
        samples: 1 kHz table: time_s, pressure_kpa, setpoint_kpa, inlet_cmd, outlet_cmd, ...
        force: table of the balance or load cell: time_s, force_n.
        length: table of the pictures taken: time_s, length_mm (nan where no length was found).
    """

    def __init__(self, samples: pd.DataFrame, force: pd.DataFrame, length: pd.DataFrame) -> None:
        self.samples = samples
        self.force = force
        self.length = length

    def plot(self, axes: tuple[Axes, Axes] | None = None) -> tuple[Axes, Axes]:
        """Draw pressure with set-point, and force, against time; returns both axes.

        Args:
            axes: for pressure and force; a new figure without them.
        """
        import matplotlib.pyplot as plt

        if axes is None:
            _, axes = plt.subplots(2, 1, sharex=True, layout="constrained")
        top, bottom = axes
        top.plot(self.samples["time_s"], self.samples["pressure_kpa"], label="measured")
        top.plot(self.samples["time_s"], self.samples["setpoint_kpa"], "--", label="set-point")
        top.set_ylabel("pressure (kPa)")
        top.legend()
        bottom.plot(self.force["time_s"], self.force["force_n"], ".-")
        bottom.set_ylabel("force (N)")
        bottom.set_xlabel("time (s)")
        return top, bottom

    def __repr__(self) -> str:
        seconds = float(self.samples["time_s"].iloc[-1]) if len(self.samples) else 0.0
        return f"Stretch({seconds:.2f} s, {len(self.samples)} samples, {len(self.force)} forces)"


class InteractiveRig:
    """An open rig. Everything that its devices send is recorded in a run folder.

    A separate process controls the rig and sends the heartbeat, so a long computation in the
    notebook does not vent the muscle. The muscle is vented and the record closed when the ``with``
    block is left, when a call is interrupted, when a cell of a notebook raises an error, and when
    the notebook's process ends or is killed. It is vented, and the session goes on, when the muscle
    is under pressure and no call was made for ``idle_s``.

    On a virtual rig in this process's own time (port = "virtual"), time passes only during calls.

    Args:
        rig: rig file, or the name of a shipped one.
        runs: folder of runs.
        specimen, operator, note: go into the record.
        seed: of a virtual rig.
        idle_s: longest time under pressure without a call.
        log: takes messages of the bench; printed to standard error by default.

    Attributes:
        folder: the record.
        outcome: how the session ended; empty while it is open.

    Raises:
        PamrigError: the rig cannot be opened; names device or file, key and remedy.
    """

    def __init__(
        self,
        rig: str | Path = "virtual",
        runs: str | Path = "runs",
        *,
        specimen: str = "muscle",
        operator: str = "",
        note: str = "",
        seed: int | None = None,
        idle_s: float = 600.0,
        log: Callable[[str], None] | None = None,
    ) -> None:
        self.folder = Path()
        self.outcome = ""
        self._log = log or _print
        self._busy = False
        self._process: subprocess.Popen[str] | None = None
        settings = {
            "rig": str(rig), "runs": str(runs), "specimen": specimen, "operator": operator,
            "note": note, "seed": seed, "idle_s": idle_s, "parent": os.getpid(),
        }  # fmt: skip
        self._link = self._start(settings)
        try:
            first = self._receive()
        except BaseException:
            self._link.close()
            raise
        self.folder = Path(first["ready"])
        self._unhook = _close_after_failed_cell(self)

    # ---- calls ------------------------------------------------------------------------

    def read(self, length: bool = True) -> dict[str, Any]:
        """Newest reading of every channel, with standard uncertainties (keys ``u_...``).

        Args:
            length: also take a picture and measure the length; nan with a key
                ``length_refused`` if there is none in it.
        """
        answer: dict[str, Any] = self._ask("read", length=length)
        return answer

    def arm(self) -> None:
        """Enable the inlet valve."""
        self._ask("arm")

    def disarm(self) -> float:
        """Vent, disarm, confirm by the reading; returns the pressure afterwards in kPa."""
        return float(self._ask("disarm"))

    def set_pressure(self, pressure_kpa: float, timeout_s: float = 20.0) -> bool:
        """Regulate to a pressure and wait until it has settled; 0 vents.

        Args:
            pressure_kpa: gauge pressure, up to the limit of the rig.
            timeout_s: longest wait for settling; 0 does not wait.

        Returns:
            Whether the pressure has settled at the set-point; True without waiting.
        """
        answer = self._ask("set_pressure", pressure_kpa=pressure_kpa, timeout_s=timeout_s)
        return bool(answer["settled"]) if isinstance(answer, dict) else True

    def set_length(self, length_mm: float) -> None:
        """Move the stage, and wait until it has arrived.

        Args:
            length_mm: within the limits of the rig.
        """
        self._ask("set_length", length_mm=length_mm)

    def vent(self) -> None:
        """Vent, confirm by the pressure reading, and stay armed."""
        self._ask("vent")

    def tare(self) -> None:
        """Tare the balance; the muscle must be vented."""
        self._ask("tare")

    def wait(self, seconds: float) -> None:
        """Let time pass on the bench.

        Args:
            seconds: of the bench's clock.
        """
        self._ask("wait", seconds=seconds)

    def mark(self, text: str) -> None:
        """Put a text into the record.

        Args:
            text: of the event.
        """
        self._ask("mark", text=text)

    def record(self, seconds: float, pictures: int = 0) -> Stretch:
        """All samples of the next seconds, in engineering units.

        Args:
            seconds: how long.
            pictures: number of pictures that are taken for the length, evenly in time.
        """
        import pandas as pd

        tables = self._ask("record", seconds=seconds, pictures=pictures)
        length = tables.get("length", {"time_s": [], "length_mm": []})
        samples, force = (pd.DataFrame(tables[name]) for name in ("valve", "balance"))
        return Stretch(samples, force, pd.DataFrame(length))

    def point(
        self, seconds: float = 1.0, frames: int = 1, timeout_s: float = 20.0
    ) -> dict[str, Any]:
        """Settle and measure a point; it also goes into the table of the run.

        Args:
            seconds: measuring window.
            frames: pictures for the length.
            timeout_s: how long to wait for the pressure to settle.
        """
        answer: dict[str, Any] = self._ask(
            "point", seconds=seconds, frames=frames, timeout_s=timeout_s
        )
        return answer

    def close(self, reason: str = CLOSED) -> None:
        """Vent, disarm, close the record. May be called twice.

        Args:
            reason: stands in the record; one other than the default makes the run "stopped".
        """
        if self.outcome or self._process is None:
            return
        self._unhook()
        ended: dict[str, Any] = {}
        try:
            send(self._link, {"do": "close", "reason": reason})
            limit = time.monotonic() + CLOSE_S
            while "ended" not in ended and time.monotonic() < limit:
                if self._link.poll(0.2):
                    ended = receive(self._link) if not ended.get("tables") else {}
        except (OSError, EOFError, ValueError):
            pass
        self._ended(ended)

    # ---- context ----------------------------------------------------------------------

    def __enter__(self) -> InteractiveRig:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(CLOSED if kind is None else f"{kind.__name__} in the notebook")

    def __repr__(self) -> str:
        state = f"closed, {self.outcome}" if self.outcome else "open"
        return f"InteractiveRig({str(self.folder)!r}, {state})"

    # ---- inside -----------------------------------------------------------------------

    def _start(self, settings: dict[str, Any]) -> Connection:
        key = secrets.token_bytes(32)
        folder = tempfile.mkdtemp(prefix="pamrig-") if os.name == "posix" else None
        address = str(Path(folder, "rig")) if folder else None
        # A local socket or pipe with a random key: nothing of it can be reached from a network.
        with Listener(address, "AF_UNIX" if folder else "AF_PIPE", authkey=key) as listener:
            options: dict[str, Any] = {}
            if os.name == "nt":
                options["creationflags"] = subprocess.CREATE_NEW_PROCESS_GROUP  # type: ignore[attr-defined]
            else:
                options["start_new_session"] = True
            self._process = subprocess.Popen(
                [sys.executable, "-m", "rigs.interactive.worker"],
                stdin=subprocess.PIPE, text=True, **options,
            )  # fmt: skip
            assert self._process.stdin is not None
            text = json.dumps({**settings, "address": listener.address, "key": key.hex()})
            self._process.stdin.write(text + "\n")
            self._process.stdin.close()
            link: Connection = listener.accept()
        if folder:
            with contextlib.suppress(OSError):
                Path(folder).rmdir()
        return link

    def _ask(self, what: str, **more: Any) -> Any:
        if self.outcome:
            raise DeviceError("rig", f"the session has ended ({self.outcome})", "open_rig again")
        if self._busy:
            raise DeviceError("rig", "another call is being carried out", "one call at a time")
        self._busy = True
        try:
            send(self._link, {"do": what, **more})
            return self._answer()
        except PamrigError:
            raise
        except BaseException as error:  # Ctrl-C, "interrupt kernel", a broken connection
            self.close(f"{type(error).__name__} during {what}()")
            raise
        finally:
            self._busy = False

    def _answer(self) -> Any:
        message = self._receive()
        if message.get("tables"):
            return receive_tables(self._link)
        if "refused" in message:
            raise _error(message["refused"])
        return message.get("answer")

    def _receive(self) -> dict[str, Any]:
        """The next message that answers something; others are dealt with.

        Raises:
            DeviceError: the session has ended; says why.
        """
        while True:
            try:
                message = receive(self._link)
            except (EOFError, OSError) as error:
                self._ended({})
                raise DeviceError(
                    "rig", "the process that held the rig has gone", "see the last run"
                ) from error
            if "log" in message:
                self._log(str(message["log"]))
            elif "ask" in message:
                send(self._link, {"do": "answer", "text": input(f">> {message['ask']} ")})
            elif "ended" in message:
                self._ended(message)
                raise _error(message.get("reason") or {"where": "rig", "what": "closed"})
            else:
                return message

    def _ended(self, message: dict[str, Any]) -> None:
        self.outcome = str(message.get("ended") or "interrupted")
        if message.get("folder"):
            self.folder = Path(message["folder"])
        self._link.close()
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(CLOSE_S)


def _error(told: dict[str, str]) -> PamrigError:
    """An error of the other process, of its own type where that is a known one."""
    kind = ERRORS.get(told.get("kind", ""), DeviceError)
    return kind(told["where"], told["what"], told.get("remedy", ""))


def _print(text: str) -> None:
    print(text, file=sys.stderr)


def _close_after_failed_cell(rig: InteractiveRig) -> Callable[[], None]:
    """In IPython: close the rig after a cell that raised. Returns what undoes this."""
    shell: Any = None
    if "IPython" in sys.modules:
        from IPython import get_ipython  # type: ignore[import-not-found,unused-ignore]

        shell = get_ipython()
    if shell is None:
        return lambda: None

    def after_cell(result: Any) -> None:
        if not result.success and not rig.outcome:
            rig.close(f"{type(result.error_in_exec).__name__} in a cell")
            _print(f"pamrig: the cell failed, so the rig was vented and closed ({rig.folder})")

    shell.events.register("post_run_cell", after_cell)

    def undo() -> None:
        with contextlib.suppress(ValueError):
            shell.events.unregister("post_run_cell", after_cell)

    return undo
