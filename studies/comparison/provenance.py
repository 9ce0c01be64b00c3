"""Origin of the gains of the finger controllers; tuning of the loops together and one by one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plant.constants import PlantConstants
from plant.finger import Finger
from studies.comparison.figures import PathFigures, StepFigures, path_figures, step_figures
from studies.comparison.study import STEP_JOINT
from studies.controllers.feedforward import MARGIN
from studies.controllers.laws import Tuning, critical, pid_law, tuning
from studies.controllers.loop import run_law
from studies.controllers.reference import circle, step
from studies.controllers.tuning import Critical, loops_critical


@dataclass(frozen=True)
class Provenance:
    """Inputs and results of the tuning rules for one valve.

    `together` is the critical gain with all loops closed, `apart` that of each joint with the
    other loops open, both relative to the static gain of the joint. `with_together` and
    `with_apart` are the step of 20 degrees and the circle with the Ziegler-Nichols gains from
    each.
    """

    tuning: Tuning
    together: Critical
    apart: dict[str, Critical]
    with_together: tuple[StepFigures, PathFigures]
    with_apart: tuple[StepFigures, PathFigures]

    def as_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        t = self.tuning
        return {
            "pressure_dead_s": t.response.dead_s,
            "pressure_lag_s": t.response.lag_s,
            "lead_s": t.lead_s,
            "integral_critical_per_s": t.critical_rate,
            "integral_per_s": t.critical_rate / MARGIN,
            "oscillations": [
                {"frequency_hz": hz, "damping_ratio": share} for hz, share in self.oscillations
            ],
            "critical_together": vars(self.together),
            "critical_apart": {joint: vars(found) for joint, found in self.apart.items()},
            "with_together": [dataclasses.asdict(found) for found in self.with_together],
            "with_apart": [dataclasses.asdict(found) for found in self.with_apart],
        }

    @property
    def oscillations(self) -> list[tuple[float, float]]:
        """Frequency (Hz) and damping ratio of the linear model's oscillations, slowest first."""
        waves = [pole for pole in self.tuning.model.rates if pole.imag > 1.0]
        waves.sort(key=abs)
        return [(float(abs(p) / (2.0 * np.pi)), float(-p.real / abs(p))) for p in waves]

    def text(self) -> str:
        """The results as text."""
        t = self.tuning
        waves = ", ".join(f"{hz:.1f} Hz (damping ratio {d:.2f})" for hz, d in self.oscillations)
        lines = [
            f"pressure loop: dead time {t.response.dead_s * 1e3:.0f} ms, "
            f"lag {t.response.lag_s * 1e3:.0f} ms",
            f"linear model: oscillations of {waves}",
            f"feed-forward: sent {t.lead_s * 1e3:.0f} ms ahead",
            f"integral: {t.critical_rate / MARGIN:.1f} 1/s, a third of the critical "
            f"{t.critical_rate:.1f} 1/s",
            f"critical gain of all loops together: {self.together.gain:.2f} of the static one, "
            f"period {self.together.period_s:.3f} s",
        ]
        lines += [
            f"critical gain of {joint} alone: {c.gain:.2f}, period {c.period_s:.3f} s"
            for joint, c in self.apart.items()
        ]
        both = (("together", self.with_together), ("one at a time", self.with_apart))
        for words, (stepped, turned) in both:
            lines.append(
                f"PID with the gains found {words}: range of {STEP_JOINT} after the step "
                f"{stepped.ripple_deg:.2f} degrees, largest error of another joint "
                f"{stepped.others_error_deg:.2f} degrees; circle {turned.rms_mm:.2f} mm rms"
            )
        return "\n".join(lines)


def provenance(
    finger: Finger, constants: PlantConstants, progress: Callable[[str], None]
) -> Provenance:
    """Compute all results, in about half a minute. Raises `PlantError` if a search fails."""
    progress("pressure loop and linear model")
    made = tuning(finger, constants)
    progress("critical gain of all loops together")
    together = critical(finger, constants)
    apart = {}
    for joint in finger.joints:
        progress(f"critical gain of {joint} alone")
        apart[joint] = loops_critical(finger, constants, (joint,))
    progress("steps with either set of gains")
    return Provenance(
        made,
        together,
        apart,
        _tried(finger, constants, [together] * len(finger.joints)),
        _tried(finger, constants, list(apart.values())),
    )


def _tried(
    finger: Finger, constants: PlantConstants, found: list[Critical]
) -> tuple[StepFigures, PathFigures]:
    law = pid_law(finger, constants, found)
    stepped, turned = (
        run_law(finger, constants, law, reference)
        for reference in (step(finger, STEP_JOINT), circle(finger))
    )
    return step_figures(stepped, finger.arm.joint(STEP_JOINT)), path_figures(turned)
