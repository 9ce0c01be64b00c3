"""Thresholds of validation: predictions of new trials, and designed comparisons of residuals."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ValidationConfig:
    """Thresholds of `gap.validation`."""

    shown_chi2: float = 120.0
    """Chi-square that new trials must leave without an explanation beyond what they leave with it:
    below it they show nothing for or against it. Set on: investigations of withheld benches."""
    predicted_share: float = 0.9
    """Least share of the gap of new trials that a confirmed explanation predicts."""
    refuted_share: float = 0.5
    """Share below which new trials refute an explanation."""
    outpredicted: float = 2.0
    """How many times what an explanation of inexact form leaves of new trials, beyond noise, every
    rival must leave for them to speak for it. Set on: investigations of withheld benches up to seed
    721, where 8 of 8 such predictions were those of the right family."""
    outpredicted_tests: int = 2
    """Such tests that prove an explanation. A matter of definition: one may be chance."""
    most_rivals: int = 4
    """Other explanations of the search that new trials are compared with."""
    least_rivals: int = 2
    """Rivals of other families in any case: the nearest are fitted for it."""
    family_wise: float = 0.01
    """Rate of data sets without a gap in which any designed comparison may raise an alarm, and rate
    of those in which any drift over the trials may."""
    by_noise: float = 0.05
    """Rate of such data sets in which noise alone makes the largest comparison as large as one
    that raises an alarm. A matter of definition."""
    drift_sd: float = 3.6
    """Sd from which a drift that an explanation leaves is no chance: the explanation was chosen
    among many, and not for its drift. Set on: not recorded."""
    most_terms: int = 5
    """Terms that an empirical correction may have."""
    least_slots: int = 3
    """Slots without which nothing can be held out of one. A matter of definition."""
    most_words: int = 4
    """Terms of a compact expression."""
    refitted_terms: int = 4
    """Terms with which the constants are fitted anew, beside the selected ones. Set on: not tuned.
    """
    moved_sd: float = 0.5
    """Change of a constant, in sd, from which terms are selected anew at the new constants. Set on:
    not tuned."""
    astray_sd: float = 3.0
    """Shift of a constant, in sd, that a gap without a name may have caused. A matter of
    definition: the constants' walls begin there."""
    term_errors: float = 1.0
    """Standard errors over slots by which a term must lower the held-out error to enter. Set on:
    practice sets 9000-9029; none of six sets without a gap among them got a term at 1 or 1.5."""
    term_share: float = 0.03
    """Share of the gap above the floor that it must close. Set on: not tuned."""
    further_share: float = 0.15
    """The same of a term that is not the first: small ones do not predict other slots. Set on:
    practice sets 43112 to 43351."""
    alike_share: float = 0.15
    """Share of a step's gain that a simpler term may give away. Set on: practice sets 9000-9029."""
    large_slot: float = 0.1
    """Share of the gap from which a slot holds a large part of it. A matter of definition."""
    foretold_share: float = 0.9
    """Share of the gap above which a term closes it where one slot holds it and the jackknife says
    nothing; from there on no other constants are tried either. Set on: practice set 43115."""
    foretold_slots: int = 3
    """Slots with a gap larger than their floor, of each of which a term must foretell half, for it
    to close the gap although one of them holds most of it. A matter of definition."""
    few_numbers: int = 3
    """Numbers of a term that one slot alone may tell, where without it no other shows a gap. A
    matter of definition."""
    few_left: float = 0.01
    """Share of the gap that such a term may leave, in squares. Set on: practice set 70231, where a
    stand-in that left 6 % closed nothing on other trials."""
    term_sd: float = 2.0
    """Prior of a term's coefficients, in rms of the residual: they go back to none where no row is.
    Set on: practice sets 44321 and 44343; 1 does as well, at 5 a term went astray there."""
    term_bend: float = 0.5
    """Prior of their second differences, in rms of the residual; first ones have twice as much. It
    carries a term over settings that are left out."""


VALIDATION = ValidationConfig()
"""The configuration that ships."""
