"""Every threshold of the search, in one place.

A gain is a drop of chi-square: of the whitened sum of squares, the prior of the constants included.
The gap is the chi-square of the recalibrated plant beyond the number of rows; what is left is the
same after the effects found so far. "Not recorded" says that no note tells on which data a value
was set. All of them were in force when practice sets 8600 to 9029 and later campaigns were scored.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SelectionConfig:
    """Thresholds of forward selection, inclusion test, pruning, swap step and timing checks."""

    # First effect
    least_gain: float = 28.0
    """Least gain of a first effect, whatever the null distribution gives. Set on: not recorded."""
    null_rate: float = 0.002
    """Rate of data sets without a gap in which chance alone may reach the alarm; false alarms.
    Set on simulated data sets, drawn anew from the noise of each data set."""
    null_factor: float = 1.7
    """The alarm in units of the gain at `null_rate`: real noise has other laws than the simulated.
    Fewer false alarms on nominal sets. Set on: practice sets; numbers not recorded."""
    sure_gain: float = 100.0
    """Gain from which a first effect needs no test on held-out slots. Set on: not recorded."""
    held_out_share: float = 0.3
    """Least share of its gain that a smaller first effect must have on held-out slots; faults of a
    few trials do not. Set on: not recorded."""

    # Forward selection
    most_effects: int = 6
    """Most effects of one explanation. More effects found at once. Set on: sets 0 to 11 of the
    stream `several`; no count on practice sets 9300 to 9347 changed from 3."""
    fitted_candidates: int = 7
    """Most candidates that are fitted at a step, best linear gain first."""
    fitted_own_channels: int = 4
    """Most further candidates that are fitted because they show in channels of their own."""
    fitted_share: float = 0.3
    """Least linear gain of a fitted candidate, as a share of the best."""
    shifted_constant_sd: float = 2.2
    """Shift of a constant, in sd, from which an effect may have moved it."""
    scan_excess_per_row: float = 0.3
    """Gap per row from which whole clock offsets and valve delays are tried."""
    scan_delays_ms: tuple[float, ...] = (3.0, 8.0, 15.0, 25.0)
    """Valve delays that are tried on tests of a controller."""
    scan_clocks_ms: tuple[float, ...] = (
        8.0, 20.0, 45.0, 80.0, 120.0, 170.0, 230.0, 300.0, 380.0, 480.0,
    )  # fmt: skip
    """Clock offsets that are tried, both ways."""

    # Fits of one more effect
    fitted_shapes: int = 2
    """Shapes of a candidate that are fitted, best linear gain first."""
    fitted_shape_share: float = 0.7
    """Least linear gain of the second shape, as a share of the first."""
    rivals_in_best_form: int = 3
    """Rivals for which all forms are fitted with the numbers of their shapes."""
    near_rival: float = 4.0
    """Such a rival leaves at most so many times more than the best, or than chance."""
    near_rival_share: float = 0.5
    """Or it takes at least this share of the gap."""
    second_shape_gain: float = 20.0
    """Least linear gain of a second shape of the same effect."""
    second_shape_of_gap: float = 0.01
    second_shape_of_left: float = 0.03
    """The same as a share of the gap, or of what is left, whichever is less."""
    second_shape_fitted: float = 15.0
    """Least gain of the second shape once it is fitted."""
    second_shapes: int = 2
    """Forms that are fitted as the second shape, the most promising first."""

    curve_of_gap: float = 0.1
    curve_of_left: float = 0.5
    """Share of the gap that the other forms of an effect leave at least, and share of that which a
    curve must take. A matter of definition; no other values were tried."""

    # Inclusion test of a further effect
    further_visibility: float = 0.45
    """Least drop of the residual in some block, in units of its floor.
    Set on: as `most_effects`."""
    further_share: float = 0.06
    """Share of the gap from which a visible effect is included: less may only correct the form of
    the first effect. Set on: not recorded."""
    exact_gain: float = 1.5
    """Least gain, in alarms, of a visible effect beside one that leaves nothing."""
    unseen_of_left: float = 0.5
    """Share of what is left from which an effect that also takes `further_share` of the gap is
    included whatever its visibility. Set on: as `fair_visibility`."""
    plain_visibility: float = 1.5
    plain_of_left: float = 0.2
    """Visibility and share of what is left from which an effect is included beside one whose form
    leaves much. Set on: pairs among the practice sets; numbers not recorded."""
    fair_visibility: float = 1.0
    fair_of_left: float = 0.1
    """The same for an effect that takes `nothing_share` of the gap. What only corrects a form has a
    low probability of presence and is not named (`gap.decision.presence`). More effects found at
    once. Set on: sets 400 to 412 of the stream `several`."""
    nothing_gain: float = 450.0
    nothing_of_left: float = 0.9
    nothing_share: float = 0.01
    nothing_visibility: float = 0.1
    """Gain, share of what is left, share of the gap and visibility of an effect of another family
    that leaves nothing. Set on: pairs among the practice sets, numbers not recorded; the share as
    `most_effects`: beside one of 8 floors an effect of 1 floor takes hardly more."""
    all_gain: float = 1000.0
    all_of_left: float = 0.97
    """Gain and share of what is left from which `nothing_share` does not matter: the first effect
    may be a thousand times the second."""
    freed_gain: float = 120.0
    """Least gain of an effect that brings a constant back from the end of its tolerance."""
    freed_from_sd: float = 2.9
    freed_to_sd: float = 2.4
    """Shift before and after, in sd, of a constant that an effect frees."""

    # Further effects for which presence decides (`gap.selection.further`)
    beside_fitted: int = 5
    """Candidates that are fitted at a step, best linear gain first. No other value was tried."""
    beside_alarms: float = 1.5
    """Least gain of such an effect, in alarms."""
    beside_of_gap: float = 1e-4
    """Least share of the gap of such an effect, unless it shows in channels of its own: no form is
    exact to a hundredth of the first effect's size. A matter of definition."""
    beside_of_left: float = 0.3
    """Share of what is left from which it need not be visible. More effects found at once. Set on:
    sets 500 to 521 of the stream `several`, as is `beside_alarms`."""

    # Exchanges of one or two effects for others (`gap.selection.exchange`)
    exchange_cost: float = 1.0
    """What an effect of an explanation costs, in alarms, and what an exchange must gain beyond it.
    As for a first effect; no other value was tried."""
    exchange_fitted: int = 4
    """Exchanges that are fitted in a round, best linear cost first. No other value was tried."""
    exchange_rounds: int = 4
    """Most exchanges. No other value was tried."""

    # Pruning
    needless_weight: float = 10.0
    """Linear weight of an effect, in alarms, from which no fit without it is tried."""
    held_out_level: float = 0.95
    """Confidence of the held-out gain of a further effect: one in twenty needless ones stays."""
    most_gain: float = 240.0
    most_share: float = 0.1
    most_of_left: float = 0.6
    """Gain, share of the gap and share of what is left from which a further effect needs no
    held-out gain: an effect of a valve shows in few slots."""
    form_share: float = 0.12
    """Share of what is explained below which an effect in the same channels, not plainly visible,
    only corrects the form of the one before."""
    relief_sd: float = 2.0
    relieved_sd: float = 3.0
    """Drop of the largest shift, and largest shift after it, of constants that an effect relieves:
    held-out slots cannot tell it from them."""

    # Swap step
    swap_candidates: int = 2
    """Candidates that are fitted in the place of each effect."""
    swap_share: float = 0.5
    """Least linear gain of such a candidate, as a share of that of the effect."""
    swap_gain: float = 4.0
    """Least gain of a swap."""

    # Defects of the recording
    defect_share: float = 0.75
    """Least share of the gap that a defect must explain alone."""
    defect_spread: float = 0.15
    """Most spread over trials, beyond chance, of the amount of a defect, over that amount."""
    least_smoothed: float = 1.5
    """Width of a smoothing, one sd over the spacing of samples, below which it may only take away
    what a noisy pressure brings into a predicted force: seven of eight benches of another generator
    without any effect were called unknown for 0.6 to 1.1. No other value was tried."""
    shared_chance: float = 4.0
    """Chi-square that replicates must share, in sd of chance, for a smoothing to be no noise. As
    for an unknown gap (`DecisionConfig.unexplained_chance`)."""
    defect_worse_share: float = 0.1
    """Share of the gap by which effects may fit worse than a defect and still be named."""
    least_clock_ms: float = 5.0
    """Delay below which a late channel may be a slow sensor instead of a wrong clock."""
    slow_sensor_ms: float = 30.0
    """The same for a pressure that a lag explains nearly as well: sensors and a metre or two of
    thin tube take up to some ten milliseconds. No other value was tried."""

    # Per-stroke delays
    stroke_sd: float = 0.1
    """Sd of the delay of one stroke about the mean of all, as a share of it."""
    stroke_most_sd: float = 3.0
    """Most sd that a stroke may be off: a delay that grows stroke by stroke is no chance."""

    # Timing of channels
    timing_excess_per_row: float = 0.2
    """Gap per row from which a channel out of time would show."""
    timing_far_better: float = 0.4
    """Most that a fault may leave of what the best other relation leaves."""
    timing_trial_better: float = 0.75
    timing_most_trials: float = 0.6
    """The same for one trial, and the share of the error that such trials must hold."""
    timing_least_shift: int = 3
    """Least shift of a late channel, in steps of 10 ms."""

    timing_widths_s: tuple[float, ...] = (0.05, 0.08, 0.12, 0.18, 0.25, 0.35, 0.5, 0.7)
    """Widths of a smoothing both ways that are tried."""
    timing_lags_s: tuple[float, ...] = (0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.6)
    """One-sided lags, which a sound sensor may have, that they are tried beside."""
    timing_shifts_s: tuple[float, ...] = (0.01, 0.02, 0.04, 0.07, 0.11, 0.16, 0.23, 0.32, 0.45)
    """Shifts in time that a smoothing is tried beside."""
    timing_least_span_kpa: float = 30.0
    timing_least_span_n: float = 4.0
    """Least travel within a trial for its edges to say anything. Set on: not recorded."""
    timing_least_left_kpa: float = 2.0
    timing_least_left_n: float = 0.3
    """Least error without smoothing, rms: below it there is nothing to explain. Fewer sound
    channels are refused. Set on: not recorded."""


SELECTION = SelectionConfig()
"""The configuration that ships; it is the default of every function."""
