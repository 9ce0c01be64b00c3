"""What run.json and final.json must be shaped like before anybody looks into them.

A seal shows that bytes are as they were written, not that pamrig wrote them. A member that is no
table where one is expected makes the file damaged, here, once, not a traceback wherever it is used.
"""

from __future__ import annotations

from typing import Any

TABLES = {
    "run.json": (
        "started", "parameters", "rig", "limits", "conditions", "camera", "calibrations", "devices",
        "software", "virtual", "load", "continues", "instrument_calibrations", "stated_uncertainty",
    ),
    "final.json": ("rows", "files", "ended", "counters", "clock_fit", "write_failure"),
    "derived/manifest.json": ("files",),
}  # fmt: skip
"""Members that are tables where they are there at all."""
MAY_BE_NULL = {"camera", "virtual", "load", "continues", "stated_uncertainty", "write_failure"}
TEXTS = {"run.json": ("run_id", "schema", "protocol"), "final.json": ("run_id", "outcome")}
"""Members that are words where they are there at all."""


def misshapen(name: str, fields: dict[str, Any]) -> str:
    """What of a sealed file is not shaped as pamrig writes it, in words; "" if nothing is.

    Args:
        name: of the file within the run folder.
        fields: its members.
    """
    for key in TABLES.get(name, ()):
        value = fields.get(key)
        listed = key == "calibrations" and isinstance(value, list)
        rows = value.values() if isinstance(value, dict) else value if listed else ()
        left_out = key not in fields or (value is None and key in MAY_BE_NULL)
        if not left_out and not isinstance(value, dict) and not listed:
            return f"its {key!r} is no table"
        if key.endswith("calibrations") and not all(isinstance(row, dict) for row in rows or ()):
            return f"its {key!r} hold something else than tables"
    for key in TEXTS.get(name, ()):
        if key in fields and not isinstance(fields[key], str):
            return f"its {key!r} is no text"
    files = fields.get("files")
    if isinstance(files, dict) and name in ("final.json", "derived/manifest.json"):
        for file, sums in files.items():
            known = isinstance(sums, dict) and type(sums.get("size")) is int
            if not known or not isinstance(sums.get("crc32"), str):
                return f"its 'files' do not say size and CRC of {file!r}"
    if name == "final.json" and not {"run_id", "outcome", "files"} <= fields.keys():
        return "it does not say how the run ended"
    return ""
