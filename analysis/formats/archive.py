"""Runs as one archive to publish: a zip file that is an RO-Crate.

RO-Crate 1.1 (https://w3id.org/ro/crate/1.1) describes a folder by JSON-LD with schema.org terms.
General repositories take such an archive as it is. Each table's columns are ``PropertyValue`` with
unit; each file has its SHA-256.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from html import escape
from pathlib import Path
from typing import Any

from analysis.formats.columns import Column, described
from daq.errors import ConfigError
from daq.record.disk import disk_error
from daq.record.safe_read import names_inside, open_inside
from daq.store.run import Run
from daq.version import version

CONFORMS = "https://w3id.org/ro/crate/1.1"
TERMS = ("sha256", "creditText")
"""Of schema.org, which the context of RO-Crate 1.1 does not have yet."""
CONTEXT = [f"{CONFORMS}/context", {term: f"https://schema.org/{term}" for term in TERMS}]
LICENCES = "https://spdx.org/licenses/"
PROGRAM = "#pamrig"
LARGEST = 1 << 40
BLOCK = 1 << 20
OCTETS = "application/octet-stream"
FORMATS = {
    ".csv": "text/csv", ".json": "application/json", ".jsonl": "application/jsonl",
    ".html": "text/html", ".txt": "text/plain", ".toml": "application/toml",
    ".parquet": "application/vnd.apache.parquet", ".arrows": "application/vnd.apache.arrow.stream",
    ".rrd": OCTETS, ".cff": "text/yaml", ".mjpg": "video/x-motion-jpeg",
}  # fmt: skip
KINDS = {
    "table": "settled points, one a row",
    "samples": "readings of the valve controller, one each millisecond",
}


def _key(name: str) -> str:
    """The address of a person or institution inside the archive."""
    return "#" + re.sub(r"\W+", "-", name.lower())


@dataclass(frozen=True)
class Author:
    """Who made the data.

    Attributes:
        name: given name and family name.
        orcid: 16 digits in groups of four; empty for none.
        affiliation: institution; empty for none.
    """

    name: str
    orcid: str = ""
    affiliation: str = ""

    @property
    def key(self) -> str:
        """The address of the person in the archive."""
        if self.orcid:
            return f"https://orcid.org/{self.orcid}"
        return _key(self.name)


@dataclass(frozen=True)
class Publication:
    """What is said of an archive.

    Attributes:
        title, description: of the data.
        licence: an SPDX identifier, or an address.
        authors: at least one.
        publisher: institution that publishes; empty if none is stated.
        published: day of publication.
    """

    title: str
    licence: str
    authors: tuple[Author, ...]
    description: str = ""
    publisher: str = ""
    published: date = field(default_factory=lambda: datetime.now(UTC).date())

    @property
    def licence_url(self) -> str:
        """Address of the licence."""
        return self.licence if "://" in self.licence else LICENCES + self.licence


def read_author(text: str) -> Author:
    """An author from ``Name``, ``Name, ORCID`` or ``Name, ORCID, affiliation``.

    Raises:
        ConfigError: no name, or an ORCID whose check digit is wrong.
    """
    name, *rest = (part.strip() for part in text.split(","))
    if not name:
        raise ConfigError("--author", f"{text!r} has no name", "Name, ORCID, affiliation")
    orcid = rest.pop(0).rsplit("/", 1)[-1] if rest and re.search(r"\d{4}-\d{4}", rest[0]) else ""
    if orcid and not _orcid_is_right(orcid):
        raise ConfigError("--author", f"{orcid!r} is not an ORCID", "four groups of four digits")
    return Author(name, orcid, ", ".join(rest))


def _orcid_is_right(text: str) -> bool:
    """Whether the last digit is the check digit of ISO 7064 MOD 11-2."""
    if not re.fullmatch(r"(\d{4}-){3}\d{3}[\dX]", text):
        return False
    total = 0
    for digit in text.replace("-", "")[:-1]:
        total = (total + int(digit)) * 2
    return "0123456789X"[(12 - total % 11) % 11] == text[-1]


def read_licence(text: str) -> str:
    """An SPDX identifier or an address, as given.

    Raises:
        ConfigError: it is neither.
    """
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.+-]*", text) or re.fullmatch(r"https?://\S+", text):
        return text
    raise ConfigError("--licence", f"{text!r} is no SPDX identifier", "for example CC-BY-4.0")


def write_archive(
    runs: Sequence[Run], about: Publication, out: Path, record: bool = True
) -> list[str]:
    """Write the archive.

    Args:
        runs: opened runs, each once.
        about: what is said of them.
        out: the file; must not exist.
        record: also the raw record of each run, byte for byte.

    Returns:
        What a check of the records found, one line each; it stands in the archive too.

    Raises:
        ConfigError: a run is named twice, or the file exists.
        RecordError: a record cannot be reduced, or the file cannot be written.
    """
    names = [run.run_id for run in runs]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(name, "is named twice", "name each run once")
    if out.exists():
        raise ConfigError(str(out), "exists already", "choose another name")
    part = out.with_name(out.name + ".partial")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as file:
            crate = _Crate(file, about)
            for run in runs:
                crate.add_run(run, record)
            crate.close()
        part.replace(out)
    except OSError as error:
        raise disk_error(out, "the archive cannot be written", error) from error
    finally:
        part.unlink(missing_ok=True)
    return crate.findings


class _Crate:
    """An archive that is being written."""

    def __init__(self, file: zipfile.ZipFile, about: Publication) -> None:
        self._file = file
        self._about = about
        self._entities: list[dict[str, Any]] = []
        self._parts: list[str] = []
        self._sums: list[tuple[str, str]] = []
        self._variables: dict[str, dict[str, Any]] = {}
        self._simulated: list[str] = []
        self.findings: list[str] = []

    def add_run(self, run: Run, record: bool) -> None:
        """Tables, report and, if wanted, the record of a run."""
        from analysis.formats.export import tables_of, write_csv
        from analysis.reporting.conditions import simulated
        from analysis.reporting.derived import derive_all
        from analysis.run_table import record_findings

        found = [f"{run.run_id}: {text}" for text in record_findings(run)]
        self.findings += found
        if simulated(run):
            self._simulated.append(run.run_id)
        folder = f"{run.run_id}/"
        self._file.writestr(folder, b"")
        inside = []
        for name, table in tables_of(run).items():
            data = io.BytesIO()
            write_csv(table, data)
            columns = described([str(c) for c in table])
            what = f"{KINDS.get(name, f'readings of {name}')} ({len(table)} rows)"
            path = self._write(f"{folder}{name}.csv", [data.getvalue()], what, columns)
            inside.append(path)
        report = derive_all(run.folder).folder / "derived" / "report.html"
        inside.append(self._write(f"{folder}report.html", [report.read_bytes()], "report"))
        if record:
            inside += self._record(run, folder)
        self._parts.append(folder)
        manifest = run.manifest
        text = f"{manifest.get('protocol')} test of {manifest.get('specimen')}: {run.outcome}"
        self._entities.append(
            {
                "@id": folder, "@type": "Dataset", "name": run.run_id, "description": text,
                "hasPart": _references(inside),
                "temporalCoverage": str((manifest.get("started") or {}).get("utc", "")),
            }
        )  # fmt: skip

    def _record(self, run: Run, folder: str) -> list[str]:
        paths = []
        for name, _ in names_inside(run.folder):
            if name.startswith("derived"):
                continue
            with open_inside(run.folder, name, LARGEST) as (source, _):
                blocks = iter(lambda s=source: s.read(BLOCK), b"")  # type: ignore[misc]
                paths.append(self._write(f"{folder}record/{name}", blocks, "part of the record"))
        return paths

    def _write(
        self, path: str, blocks: Iterable[bytes], what: str, columns: Sequence[Column] = ()
    ) -> str:
        """Store a file and its description; returns its path."""
        total, size = hashlib.sha256(), 0
        with self._file.open(path, "w", force_zip64=True) as out:
            for block in blocks:
                total.update(block)
                size += len(block)
                out.write(block)
        entity: dict[str, Any] = {
            "@id": path, "@type": "File", "name": path.rsplit("/", 1)[-1], "description": what,
            "contentSize": str(size), "sha256": total.hexdigest(),
            "encodingFormat": FORMATS.get(Path(path).suffix, OCTETS),
        }  # fmt: skip
        if columns:
            entity["variableMeasured"] = _references(map(self._variable, columns))
        self._sums.append((total.hexdigest(), path))
        self._entities.append(entity)
        return path

    def _variable(self, column: Column) -> str:
        """The address of a column's description, which all tables share."""
        key = f"#column-{column.name}"
        value: dict[str, Any] = {
            "@id": key, "@type": "PropertyValue", "name": column.name,
            "description": column.meaning,
        }  # fmt: skip
        if column.unit:
            value |= {"unitText": column.unit, "unitCode": column.unit_code}
        if column.uncertainty:
            about = f"its standard uncertainty stands in the column {column.uncertainty}"
            value["measurementTechnique"] = about
        self._variables.setdefault(key, value)
        return key

    def close(self) -> None:
        """Write sums, citation, description and preview."""
        about = self._about
        self._write("CITATION.cff", [_citation(about).encode()], "how to cite these data")
        self._parts.append("CITATION.cff")
        sums = "".join(f"{digest}  {path}\n" for digest, path in self._sums)
        self._write("manifest-sha256.txt", [sums.encode()], "sums of the files, for sha256sum -c")
        self._parts.append("manifest-sha256.txt")
        graph = [_descriptor(), self._root(), *_context(about), *self._entities]
        crate = {"@context": CONTEXT, "@graph": [*graph, *self._variables.values()]}
        text = json.dumps(crate, indent=1, ensure_ascii=False, allow_nan=False)
        self._file.writestr("ro-crate-metadata.json", text + "\n")
        self._file.writestr("ro-crate-preview.html", _preview(about, self._description, sums))

    @property
    def _description(self) -> str:
        text = self._about.description or f"{self._about.title}, measured with pamrig."
        if self._simulated:
            text += f" SIMULATED, not measured: {', '.join(self._simulated)}."
        for found in self.findings:
            text += f" A check of the record found: {found}."
        return text

    def _root(self) -> dict[str, Any]:
        about = self._about
        publisher = {"publisher": {"@id": _key(about.publisher)}} if about.publisher else {}
        return {
            "@id": "./", "@type": "Dataset", "name": about.title,
            "description": self._description,
            "datePublished": about.published.isoformat(),
            "license": {"@id": about.licence_url},
            "author": _references(author.key for author in about.authors),
            "keywords": "pneumatic artificial muscle, McKibben",
            "creditText": _credit(about),
            "hasPart": _references(self._parts),
            "mentions": {"@id": "#create"},
            **publisher,
        }  # fmt: skip


def _references(keys: Iterable[str]) -> Any:
    """References to entities; RO-Crate wants a single one without a list."""
    found = [{"@id": key} for key in keys]
    return found[0] if len(found) == 1 else found


def _descriptor() -> dict[str, Any]:
    return {
        "@id": "ro-crate-metadata.json", "@type": "CreativeWork",
        "conformsTo": {"@id": CONFORMS}, "about": {"@id": "./"},
    }  # fmt: skip


def _context(about: Publication) -> list[dict[str, Any]]:
    """Licence, people, institutions and the program that made the files."""
    out: list[dict[str, Any]] = [
        {
            "@id": about.licence_url, "@type": "CreativeWork", "name": about.licence,
            "description": f"The licence {about.licence} applies to these data.",
        },
        {
            "@id": PROGRAM, "@type": "SoftwareApplication", "name": "pamrig",
            "version": version(), "softwareVersion": version(),
        },
        {
            "@id": "#create", "@type": "CreateAction", "name": "recorded, reduced and packed",
            "instrument": {"@id": PROGRAM}, "result": {"@id": "./"},
            "endTime": about.published.isoformat(),
            "agent": _references(author.key for author in about.authors),
        },
    ]  # fmt: skip
    places = {about.publisher} - {""}
    for author in about.authors:
        person: dict[str, Any] = {"@id": author.key, "@type": "Person", "name": author.name}
        if author.affiliation:
            person["affiliation"] = {"@id": _key(author.affiliation)}
            places.add(author.affiliation)
        out.append(person)
    return [
        *out,
        *({"@id": _key(n), "@type": "Organization", "name": n} for n in sorted(places)),
    ]


def _credit(about: Publication) -> str:
    names = "; ".join(author.name for author in about.authors)
    return f"{names} ({about.published.year}): {about.title}. {about.licence}."


def _citation(about: Publication) -> str:
    """CITATION.cff 1.2.0; JSON strings are YAML strings."""
    lines = [
        "cff-version: 1.2.0", 'message: "Cite these data as below."', "type: dataset",
        f"title: {json.dumps(about.title)}", f"date-released: {about.published.isoformat()}",
        "license-url: " + json.dumps(about.licence_url), "authors:",
    ]  # fmt: skip
    for author in about.authors:
        given, _, family = author.name.rpartition(" ")
        lines.append(f"  - family-names: {json.dumps(family)}")
        if given:
            lines.append(f"    given-names: {json.dumps(given)}")
        if author.orcid:
            lines.append(f"    orcid: {json.dumps(author.key)}")
        if author.affiliation:
            lines.append(f"    affiliation: {json.dumps(author.affiliation)}")
    return "\n".join(lines) + "\n"


def _preview(about: Publication, description: str, sums: str) -> str:
    """A page without scripts for people who open the archive."""
    paths = [line.split("  ", 1)[1] for line in sums.splitlines()]
    shown = [path for path in paths if "/record/" not in path]
    rows = "".join(f'<li><a href="{escape(p)}">{escape(p)}</a></li>' for p in shown)
    hidden = len(paths) - len(shown)
    more = f"<p>{hidden} files of the raw records are in the folders <code>record</code>.</p>"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(about.title)}</title></head>"
        '<body style="font: 16px/1.5 sans-serif; max-width: 45em; margin: 2em auto">'
        f"<h1>{escape(about.title)}</h1><p>{escape(description)}</p>"
        f"<p>{escape(_credit(about))}</p>"
        f'<p>Licence: <a href="{escape(about.licence_url)}">{escape(about.licence)}</a></p>'
        f"<h2>Files</h2><ul>{rows}</ul>{more if hidden else ''}"
        "<p>Columns, units and uncertainties are described in "
        '<a href="ro-crate-metadata.json">ro-crate-metadata.json</a>.</p></body></html>\n'
    )
