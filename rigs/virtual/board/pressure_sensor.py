"""The simulated pressure transducer with its converter: range, noise, and its own errors."""

from __future__ import annotations

from dataclasses import dataclass

ADC_TOP = 4095


@dataclass(frozen=True)
class PressureSensor:
    """Pressure transducer and 12-bit converter.

    ``zero_kpa`` and ``gain`` (relative) are this sensor's own errors, drawn by the caller: the
    reading is of ``pressure * (1 + gain) + zero + noise``, rounded and clipped to 0..4095 over
    ``low_kpa``..``high_kpa``. Noise is white, ``noise_kpa`` is one standard deviation.
    """

    low_kpa: float = 0.0
    high_kpa: float = 1000.0
    noise_kpa: float = 0.5
    zero_kpa: float = 0.0
    gain: float = 0.0

    @property
    def counts_per_kpa(self) -> float:
        """Nominal sensitivity."""
        return ADC_TOP / (self.high_kpa - self.low_kpa)

    def nominal_counts(self, pressure_kpa: float) -> float:
        """Reading of a sensor without errors, unrounded."""
        return (pressure_kpa - self.low_kpa) * self.counts_per_kpa
