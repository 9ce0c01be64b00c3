"""Holding: length and pressure are held, and the force is read at growing times."""

from dataclasses import dataclass

from pamrig.protocol import Dwell, OwnTest, SetLength, SetPressure, Steps, Vent, Zero


@dataclass(frozen=True, kw_only=True)
class Holding(OwnTest):
    """Its fields are the keys of its protocol file."""

    length_mm: float = 60.0
    pressures_kpa: tuple[float, ...] = (200.0, 400.0)
    waits_s: tuple[float, ...] = (1.0, 2.0, 4.0)

    def steps(self) -> Steps:
        """The method, top to bottom."""
        book = self.book()
        yield from book.opening(self.length_mm)
        for place, pressure in self.method.trials(list(self.pressures_kpa)):
            slot = f"P{pressure:g}"
            yield from book.remount(place)
            yield from book.begin(place, slot, "holding", (("held_pressure_kpa", pressure),))
            yield from book.tared()
            yield SetLength(self.length_mm)
            yield Zero(book.trial, "before", self.method.zero_s)
            yield SetPressure(pressure)
            for wait in self.waits_s:
                yield Dwell(wait)
                yield from book.point(place, slot, "up", pressure, length_mm=self.length_mm)
            yield Vent()
            yield from book.end()
