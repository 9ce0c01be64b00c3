"""Figures of the studies of the finger."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from analysis.figures.drawing import INK, MEASURED, QUIET, SET, new_figure, style
from plant.finger import Finger
from studies.comparison.study import BARE, LADEN, STEP_JOINT, run_trial
from studies.controllers.laws import TITLES
from studies.controllers.reference import circle, step

PICTURED = ("two", "slide", "pid", "placement", "feedforward", "adaptive")
DARK = "#D55E00"


def draw_steps(finger: Finger, folder: Path, laws: tuple[str, ...] = PICTURED) -> Path:
    """Steps without and with payload: one row per controller, one column per valve."""
    joint = finger.arm.joint(STEP_JOINT)
    with style():
        figure, axes = new_figure(8.6, 1.35 * len(laws) + 0.8, len(laws), 2, sharex=True)
        axes = np.reshape(axes, (len(laws), 2))
        reference = step(finger, STEP_JOINT)
        time = np.arange(len(reference.q)) * 1e-3 - reference.scored_from_s
        for row, law in enumerate(laws):
            for column, valve in enumerate(("thesis", "cured")):
                ax = axes[row, column]
                for case, colour in ((LADEN, DARK), (BARE, MEASURED)):
                    trial = run_trial(finger, law, valve, case, reference)
                    q = np.degrees(trial.q[:, joint])
                    ax.plot(time, q, color=colour, linewidth=1.0, label=case.title)
                goal = np.degrees(reference.q[:, joint])
                ax.plot(
                    time, goal, color=INK, linewidth=0.8, linestyle=(0, (4, 2)), label="reference"
                )
                ax.set_title(TITLES[law], loc="left", fontsize=8.5, color=INK)
                ax.set_ylim(-5, 50)
                ax.set_xlim(-0.5, 2.0)
        for column, valve in enumerate(("thesis", "cured")):
            axes[-1, column].set_xlabel(f"time after the step (s), {valve} valve")
        axes[0, 1].legend(loc="lower right", fontsize=7.5)
        figure.supylabel("base flexion (degrees)", fontsize=9)
        out = folder / "control-steps.png"
        figure.savefig(out, dpi=130)
    return out


def draw_circles(finger: Finger, folder: Path, laws: tuple[str, ...] = PICTURED) -> Path:
    """Path of the fingertip in the flexion plane: one column per controller, one row per valve."""
    with style():
        figure, axes = new_figure(2.1 * len(laws), 4.9, 2, len(laws))
        reference = circle(finger)
        assert reference.tip is not None
        begin = round(reference.scored_from_s / 1e-3)
        for row, valve in enumerate(("thesis", "cured")):
            for column, law in enumerate(laws):
                ax = axes[row, column]
                errors = []
                for case, colour in ((LADEN, DARK), (BARE, MEASURED)):
                    trial = run_trial(finger, law, valve, case, reference)
                    tip = trial.tip[begin:] * 1e3
                    distance = np.linalg.norm(trial.tip - reference.tip, axis=1)[begin:]
                    errors.append(float(np.sqrt(np.mean(distance**2))) * 1e3)
                    ax.plot(tip[:, 0], tip[:, 2], color=colour, linewidth=0.8, label=case.title)
                goal = reference.tip[begin:] * 1e3
                ax.plot(goal[:, 0], goal[:, 2], color=QUIET, linewidth=0.8, linestyle="--")
                ax.plot(*goal[0, ::2], marker="o", markersize=3, color=SET)
                ax.set_aspect("equal")
                centre = (goal.max(axis=0) + goal.min(axis=0)) / 2.0
                ax.set_xlim(centre[0] - 27, centre[0] + 27)
                ax.set_ylim(centre[2] - 27, centre[2] + 27)
                ax.set_title(
                    f"{TITLES[law]}\n{errors[1]:.2f} mm rms, 20 g: {errors[0]:.2f}",
                    loc="left",
                    fontsize=7,
                    color=INK,
                )
                if column == 0:
                    ax.set_ylabel(f"{valve} valve\nheight (mm)")
                if row == 1:
                    ax.set_xlabel("forward (mm)")
        axes[1, -1].legend(loc="lower right", fontsize=7)
        out = folder / "control-circles.png"
        figure.savefig(out, dpi=130)
    return out
