"""The thesis's schemes and the burst scheme side by side, on both simulated benches.

    python -m benchmarks.schemes                  # the table of docs/reference/valve-schemes.md
    python -m benchmarks.schemes --picture docs/images  # and its picture
    python -m benchmarks.schemes --seeds 20             # more noise realizations

The muscle is held at 60 mm. Set-points are 25 to 85 % of supply, from vented and then at least
25 % apart, 2 s each. Error is |mean true pressure - set-point| over the last half second, ripple
the range of the true pressure in it, overshoot how far beyond the set-point it ever was, switchings
how often a second either valve was energised in the last half second.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants, nominal
from plant.simulator.bench import BenchSim
from rigs.rigfile.config import load_rig
from rigs.virtual.board.as_printed import install_as_printed
from rigs.virtual.board.board import SimBoard
from rigs.virtual.board.tuning import burst_parameters, safety_parameters
from valvefw.wire import encode_frame

Floats = npt.NDArray[np.float64]

SHARES = (0.25, 0.55, 0.85, 0.5, 0.25, 0.7, 0.4)
STEP_S = 2.0
LAST_S = 0.5
COUNTS_X16_PER_KPA = 4.095 * 16
INTENDED = ("two", "duty_in", "duty", "slide")
PRINTED = tuple(f"{name}_as_printed" for name in INTENDED)
TITLES = {
    "two": "two-position",
    "duty_in": "PWM of the inlet",
    "duty": "PWM of both",
    "slide": "sliding mode",
    "burst": "bursts (pamrig)",
}
RIGS = ("virtual", "virtual-thesis")


@dataclass(frozen=True)
class Trace:
    """One staircase: true pressure each ms, and the figures of its steps in % of supply."""

    time_s: Floats
    pressure: Floats
    error: list[float]
    ripple: list[float]
    overshoot: list[float]
    switchings_per_s: list[float]
    fault: str


def constants_of(rig: str) -> PlantConstants:
    """The plant of a shipped rig."""
    config = load_rig(rig)
    assert config.virtual is not None
    return nominal().with_overrides(config.virtual.plant)


class Bench:
    """A simulated board with a host that beats and asks."""

    def __init__(self, rig: str, seed: int) -> None:
        c = constants_of(rig)
        self.supply_kpa = c.supply_pa * 1e-3
        self.plant = BenchSim(c, length_m=0.060)
        self.board = SimBoard(
            self.plant,
            np.random.default_rng([seed, 8]),
            truth_every=1,
            outlet_normally_open=c.outlet_normally == "open",
        )
        install_as_printed(self.board)
        self.beats = 0
        self.edges = 0
        values = self.board.controller.values
        values.update({**burst_parameters(c), **safety_parameters(c)})
        values["inlet_max_ms"] = 2000
        self.board.run_until_us(100_000)
        self.board.controller.safety.arm(values)

    def ask(self, text: str) -> None:
        self.board.feed(encode_frame(f"Q1 {text}".encode()))

    def run_ms(self, ms: int) -> int:
        """Let time pass; returns how often a valve was energised."""
        board = self.board
        edges = 0
        inlet = vent = True
        for k in range(ms):
            if k % 100 == 0:
                self.beats += 1
                self.ask(f"hb {self.beats}")
            board.run_until_us(board.bench_us + 1000)
            now_inlet, now_vent = board._inlet_us > 0, board._vent_us > 0
            edges += (now_inlet and not inlet) + (now_vent and not vent)
            inlet, vent = now_inlet, now_vent
        return edges


def staircase(rig: str, scheme: str, seed: int = 1, shares: tuple[float, ...] = SHARES) -> Trace:
    """Run one scheme over the set-points."""
    bench = Bench(rig, seed)
    bench.ask(f"scheme {scheme}")
    supply = bench.supply_kpa
    begin_us = bench.board.bench_us
    error, ripple, overshoot, switchings = [], [], [], []
    for share in shares:
        goal = share * supply
        before = bench.board.pressure_kpa
        at = len(bench.board.truth_kpa)
        bench.ask(f"sp {round(goal * COUNTS_X16_PER_KPA)}")
        bench.run_ms(round((STEP_S - LAST_S) * 1000))
        edges = bench.run_ms(round(LAST_S * 1000))
        p = np.array(bench.board.truth_kpa[at:])
        tail = p[-round(LAST_S * 1000) :]
        past = (p - goal).max() if goal > before else (goal - p).max()
        error.append(abs(float(tail.mean()) - goal) / supply * 100)
        ripple.append(float(np.ptp(tail)) / supply * 100)
        overshoot.append(max(0.0, float(past)) / supply * 100)
        switchings.append(edges / LAST_S)
    faults = bench.board.controller.safety.faults
    t = np.array(bench.board.truth_us, dtype=float)
    keep = t > begin_us
    return Trace(
        (t[keep] - begin_us) / 1e6,
        np.array(bench.board.truth_kpa)[keep] / supply * 100,
        error,
        ripple,
        overshoot,
        switchings,
        faults[0][0] if faults else "",
    )


def table(seeds: int) -> str:
    """Markdown, a row for each bench and scheme."""
    lines = [
        "| bench | scheme | error mean / worst | ripple mean / worst | overshoot worst "
        "| switchings a second |",
        "|---|---|---|---|---|---|",
    ]
    for rig in RIGS:
        for scheme in (*INTENDED, "burst", *PRINTED):
            traces = [staircase(rig, scheme, seed) for seed in range(seeds)]
            error = np.concatenate([t.error for t in traces])
            ripple = np.concatenate([t.ripple for t in traces])
            over = np.concatenate([t.overshoot for t in traces])
            switchings = np.concatenate([t.switchings_per_s for t in traces])
            fault = next((t.fault for t in traces if t.fault), "")
            lines.append(
                f"| {rig} | `{scheme}` | {error.mean():.2f} / {error.max():.2f} "
                f"| {ripple.mean():.2f} / {ripple.max():.2f} | {over.max():.1f} "
                f"| {switchings.mean():.0f}{f' (fault {fault})' if fault else ''} |"
            )
    return "\n".join(lines)


def picture(folder: Path) -> Path:
    """Small multiples: a row a scheme, a column a bench; as printed behind as intended."""
    from analysis.figures.drawing import INK, MEASURED, QUIET, SET, style

    with style():
        import matplotlib.pyplot as plt

        schemes = (*INTENDED, "burst")
        figure, axes = plt.subplots(
            len(schemes), 2, figsize=(8.6, 8.4), sharex=True, sharey=True, layout="constrained"
        )
        goal_t = np.repeat(np.arange(len(SHARES) + 1) * STEP_S, 2)[1:-1]
        goal = np.repeat(np.array(SHARES) * 100, 2)
        for row, scheme in enumerate(schemes):
            for column, rig in enumerate(RIGS):
                ax = axes[row, column]
                if scheme != "burst" and rig == "virtual-thesis":
                    printed = staircase(rig, f"{scheme}_as_printed")
                    ax.plot(printed.time_s, printed.pressure, color=QUIET, linewidth=0.7)
                trace = staircase(rig, scheme)
                ax.plot(trace.time_s, trace.pressure, color=MEASURED, linewidth=0.9)
                ax.plot(goal_t, goal, color=SET, linewidth=0.8, linestyle=(0, (4, 2)))
                worst = max(trace.error)
                ax.set_title(
                    f"{TITLES[scheme]}: worst error {worst:.2f} %, "
                    f"ripple {max(trace.ripple):.1f} %",
                    loc="left",
                    fontsize=8.5,
                    color=INK,
                )
                ax.set_ylim(0, 104)
                ax.set_xlim(0, len(SHARES) * STEP_S)
        for column, rig in enumerate(RIGS):
            axes[-1, column].set_xlabel(f"time (s), rig {rig}")
        figure.supylabel("pressure (% of supply)", fontsize=9)
        out = folder / "valve-schemes.png"
        figure.savefig(out, dpi=130)
        plt.close(figure)
    return out


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--picture", type=Path, help="folder for valve-schemes.png")
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    if options.picture is not None:
        print(picture(options.picture))
    print(table(options.seeds))


if __name__ == "__main__":
    main()
