"""Every threshold of the noise model and of the intervals, in one place.

"Not recorded" says that no note tells on which data a value was set.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EstimationConfig:
    """Thresholds of `gap.estimation`."""

    # Noise
    prior_weight: float = 4.0
    """Draws that the nominal size of a noise is worth beside what replicates show. A larger value
    makes few replicates harmless and many useless. Set on: not recorded."""
    trend_requested: float = 1.5
    """Z of a slow change over trials from which the noise is learnt again without it."""
    trend_sd: float = 3.5
    """Z from which it is a change, over noise that it may have raised itself. Wear that is taken
    for noise raises the floor that it has to rise above. Set on: not recorded."""
    trend_sd_without: float = 7.0
    """The same over noise learnt without the change, which chance makes look smaller."""

    # Agreement of replicates
    agreement_weight: float = 4.0
    """Replicates that the noise model is worth beside what they show of the amount of an effect.
    Set on: not recorded."""

    # Effects that differ between replicates
    by_trial_sd: float = 8.0
    """Sd of the usual noise by which a trial must have more of an effect than its replicate. Set
    on: 146 practice sets without such a trial: 10 reach this and the next."""
    by_trial_kpa: float = 1.0
    """Root mean square, kPa, by which that must move its pressure. A matter of definition: twice
    the noise of the reference bench."""
    by_trial_share: float = 0.7
    """Share of how the two replicates differ, but for a zero, that it must explain. Set on: the
    same sets; of those ten, nine have 0.23 at most, one 0.55."""

    # Stated constants
    tolerance_sd: float = 3.0
    """Shift of a constant, in sd, up to which its prior is normal: no data sheet reaches beyond."""
    beyond_weight: float = 100.0
    """Weight of the square of what a constant is shifted beyond that. It keeps a recalibration from
    doing what an effect does. Set on: not recorded."""
    taken_over_sd: float = 2.0
    """Shift of a constant, in sd, that its tolerance hardly explains: from there on it counts to
    the effect of the same meaning. Set on: not recorded."""

    # Intervals
    form_error: float = 0.1
    """Error (1 sd, of the logarithm) of the form of an effect for which none is stated."""

    # Fitness of the nominal plant
    misfit_share: float = 0.5
    """Rms error of the recalibrated plant, as a share of the rms of what was read, from which the
    plant is that of another muscle. No effect of the catalogue at the end of its range makes half
    of all force. Set on: practice sets 9100 to 9117, and measured muscles of two other makes."""
    far_sd: float = 12.0
    """Shift of a constant of the muscle, in sd, from which the plant is that of another muscle: at
    1 % of the turns and 0.3 % of the braid 12 % and 4 %. Set on: the same."""
    doubt_left: float = 0.1
    """Most of the gap that effects may leave of a plant in doubt for the doubt to go, and least
    part of it that an effect takes that may stand for another muscle (practice set 10056: a delay
    of a second was refused for a trace of another effect). No other value was tried."""
    another_muscle: float = 0.2
    """One sd of length and turns of another muscle, as a share of them, that a plant in doubt is
    compared with. No other value was tried."""
    stands_for_muscle: float = 0.5
    """An effect that takes less than this share of what it takes beside the nominal muscle, beside
    another one, may stand for that. No other value was tried."""
    beyond_braid: float = 0.1
    """Length beyond the braid's, as a share of it, from which the muscle is another one. A taut
    braid stretches by less than half of that, and a camera may read 5 mm too much (the catalogue's
    distortion), which is 6 % of the thesis's muscle. Measured muscles of other makes are beyond it
    by 200 %. A camera off by more than 10 % in scale is refused with them. Set on: set 52338 of the
    held-out forms and measured muscles of two other makes."""

    # Replicates
    same_edges_s: float = 2e-3
    """Difference of two edges of a command from which replicates were not run alike."""


ESTIMATION = EstimationConfig()
"""The configuration that ships."""
