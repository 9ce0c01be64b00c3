"""The table ``[air]``: supply, atmosphere and volume, for what the air of a cycle costs."""

from __future__ import annotations

from analysis.reduction.muscle.energy import Air
from rigs.rigfile.toml_reader import Table


def read_air(root: Table) -> Air | None:
    """The table of a protocol file; None without it: then the volume is not known.

    Raises:
        ConfigError: names file and key.
    """
    if "air" not in root:
        return None
    t = root.table("air")
    lengths = t.numbers("lengths_mm", 0.001, 10_000.0, unit="mm", least=2)
    volumes = t.numbers("volumes_ml", 0.0, 1e6, unit="ml", least=2)
    out = Air(
        supply_kpa=t.number("supply_kpa", 1.0, 2000.0, unit="kPa"),
        u_supply_kpa=t.number("u_supply_kpa", 0.0, 200.0, 0.0, unit="kPa"),
        atmosphere_kpa=t.number("atmosphere_kpa", 30.0, 120.0, unit="kPa"),
        u_atmosphere_kpa=t.number("u_atmosphere_kpa", 0.0, 20.0, 0.0, unit="kPa"),
        lengths_mm=lengths,
        volumes_ml=volumes,
        dead_ml=t.number("dead_ml", 0.0, 1e6, 0.0, unit="ml"),
        u_volume_ml=t.number("u_volume_ml", 0.0, 1e6, unit="ml"),
    )
    if len(lengths) != len(volumes) or list(lengths) != sorted(set(lengths)):
        raise t.fail("lengths_mm", "must increase, with one of volumes_ml for each", "correct them")
    t.finish()
    return out
