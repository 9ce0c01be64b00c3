"""Checks the structure of run.json, final.json and the derived manifest.

A correct CRC shows that the bytes are unchanged, not that pamrig wrote them. A file with an
unexpected structure counts as damaged. One check here replaces checks at each use.
"""

from __future__ import annotations

from typing import Any

TABLES = {
    "run.json": (
        "started", "parameters", "rig", "limits", "conditions", "camera", "calibrations", "devices",
        "software", "virtual", "load", "continues", "instrument_calibrations", "stated_uncertainty",
        "pressure_sensor", "regulator",
    ),
    "final.json": ("rows", "files", "ended", "counters", "clock_fit", "write_failure", "lateness"),
    "derived/manifest.json": ("files",),
}  # fmt: skip
"""Members that must be tables if present."""
MAY_BE_NULL = {"camera", "virtual", "load", "continues", "stated_uncertainty", "write_failure"}
TEXTS = {"run.json": ("run_id", "schema", "protocol"), "final.json": ("run_id", "outcome")}
"""Members that must be text if present."""
SCHEMAS = {"pamrig-run/1": 1, "pamrig-run/2": 2}
"""Versions of the format that can be read."""
LEAVES: dict[str, dict[str, tuple[type, ...]]] = {
    "run.json": {
        "specimen": (str,), "operator": (str,), "note": (str,), "labels": (list,),
        "started.utc": (str,), "started.wall_ns": (int,), "started.monotonic_ns": (int,),
        "rig.name": (str,), "rig.text": (str,), "rig.source": (str,), "continues.run_id": (str,),
        "continues.trials": (list,), "conditions.temperature_c": (int, float),
    },
    "final.json": {
        "reason": (str,), "ended.utc": (str,), "ended.t_ns": (int,), "duration_s": (int, float),
        "frames": (int,), "events": (int,), "write_failure.what": (str,),
    },
}  # fmt: skip
"""Types of members within tables, if present and not null."""


def structure_error(name: str, fields: dict[str, Any]) -> str:
    """Describe the first structural error of a sealed file; "" if there is none.

    Args:
        name: of the file within the run folder.
        fields: its members.
    """
    for key in TABLES.get(name, ()):
        value = fields.get(key)
        listed = key == "calibrations" and isinstance(value, list)
        rows = value.values() if isinstance(value, dict) else value if listed else ()
        absent = key not in fields or (value is None and key in MAY_BE_NULL)
        if not absent and not isinstance(value, dict) and not listed:
            return f"its {key!r} is not a table"
        if key.endswith("calibrations") and not all(isinstance(row, dict) for row in rows or ()):
            return f"an entry of its {key!r} is not a table"
    for key in TEXTS.get(name, ()):
        if key in fields and not isinstance(fields[key], str):
            return f"its {key!r} is not text"
    schema = fields.get("schema")
    if name in ("run.json", "final.json") and schema not in (None, *SCHEMAS):
        return f"is of the format {schema!r}; this version reads {', '.join(SCHEMAS)}"
    if wrong := _leaf_error(name, fields):
        return wrong
    files = fields.get("files")
    if isinstance(files, dict) and name in ("final.json", "derived/manifest.json"):
        for file, sums in files.items():
            known = isinstance(sums, dict) and type(sums.get("size")) is int
            if not known or not isinstance(sums.get("crc32"), str):
                return f"its 'files' has no size or no CRC of {file!r}"
    if name == "final.json" and not {"run_id", "outcome", "files"} <= fields.keys():
        return "its run_id, outcome or files are missing"
    return ""


def _leaf_error(name: str, fields: dict[str, Any]) -> str:
    for path, kinds in LEAVES.get(name, {}).items():
        value: Any = fields
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        if value is not None and (isinstance(value, bool) or not isinstance(value, kinds)):
            return f"its {path!r} is {value!r:.40}"
    return ""
