"""The page docs/reference/python.md: the public Python interface, made from docstrings."""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, is_typeddict

import pamrig
from docs.make.asked import HOUSE
from gap.data import simulator
from gap.verdict import Explanation, Gap, Verdict
from pamrig import protocol
from plant.effects import effect
from rigs.devices import interfaces
from rigs.devices.pressure import source
from rigs.execution.procedure import Procedure
from rigs.interactive.client import InteractiveRig, Stretch
from rigs.virtual.emulators.emulator import Emulator

PAGE = HOUSE / "docs" / "reference" / "python.md"
HEAD = """# Python interface

Made by `python -m docs.make` from signatures and docstrings. Names that are not listed here may
change without notice. Units stand in the names: `pressure_kpa`, `length_mm`, `force_n`, `time_s`.
"""


@dataclass(frozen=True)
class Group:
    """A section of the page.

    Attributes:
        title, text: heading, and the paragraph below it.
        module: from which its names are imported; "" for the module that defines each.
        names: the objects by name.
    """

    title: str
    text: str
    module: str
    names: dict[str, Any]


def _named(*found: Any) -> dict[str, Any]:
    return {one.__name__: one for one in found}


def groups() -> tuple[Group, ...]:
    """The sections in order."""
    return (
        Group(
            "pamrig", "`import pamrig`: open runs and rigs, simulate and diagnose. The tutorials "
            "([first test](../tutorials/first-test.ipynb)) and "
            "[interactive use](../use/interactive.md) show examples.", "pamrig",
            {name: getattr(pamrig, name) for name in pamrig.__all__},
        ),
        Group(
            "What these return", "Objects that are returned, not made by the user.", "",
            _named(InteractiveRig, Stretch, Verdict, Explanation, Gap),
        ),
        Group(
            "pamrig.protocol", "What a [protocol of your own](../use/own-protocols.md) is written "
            "with.", "pamrig.protocol",
            {name: getattr(protocol, name) for name in protocol.__all__},
        ),
        Group(
            "Simulators", "What a [simulator of your own](../use/your-simulator.md) implements, if "
            "it is an object and not a file.", "",
            _named(simulator.Simulator, simulator.ExternalSimulator, simulator.StaticForce,
                   simulator.Parameter, simulator.Stage),
        ),
        Group(
            "Devices", "Interfaces of drivers and emulators; see [extending](extending.md).", "",
            _named(source.PressureSource, source.SourceParts, source.PressureCommand,
                   source.PressureLimits, interfaces.Instrument, interfaces.Actuator, Emulator),
        ),
        Group(
            "Effects and protocols of the repository", "See [extending](extending.md).", "",
            _named(effect.Effect, effect.Parameter, effect.InPlant, effect.InSensors,
                   effect.InDiagnosis, effect.Search, Procedure),
        ),
    )  # fmt: skip


def page() -> str:
    """The page."""
    parts = [HEAD]
    for group in groups():
        parts.append(f"## {group.title}\n\n{group.text}\n")
        for name, one in group.names.items():
            module = group.module or one.__module__
            parts.append(_entry(name, one, module))
    return "\n".join(parts).rstrip() + "\n"


def _entry(name: str, one: Any, module: str) -> str:
    if not inspect.isclass(one):
        if isinstance(one, types.GenericAlias) or not callable(one):
            return f"### `{name}`\n\n`{module}.{name}` is {_code(_plain(one))}.\n"
        return f"### `{name}`\n\n{_signature(name, one)}\n\n{described(one)}\n"
    parts = [f"### `{name}`\n", f"`from {module} import {name}`\n"]
    if _has_constructor(one):
        parts.append(f"{_signature(name, one)}\n")
    parts.append(f"{described(one)}\n")
    for member, what in members(one):
        parts.append(f"#### `{name}.{member}`\n")
        if not isinstance(what, property):
            parts.append(f"{_signature(member, getattr(one, member))}\n")
        else:
            parts.append(f"{_code('-> ' + _returns(what))}\n")
        parts.append(f"{described(what)}\n")
    return "\n".join(parts)


def members(one: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties that a class or a public base of its own defines."""
    seen = set()
    for owner in one.__mro__:
        if owner is object or owner.__module__ in ("typing", "abc", "enum", "builtins"):
            continue
        for name, what in vars(owner).items():
            wanted = isinstance(what, (types.FunctionType, property, classmethod, staticmethod))
            if wanted and not name.startswith("_") and name not in seen:
                seen.add(name)
                yield name, what


def _has_constructor(one: type) -> bool:
    """Whether a user makes objects of the class: not of an interface."""
    return not (getattr(one, "_is_protocol", False) or inspect.isabstract(one) or is_typeddict(one))


def _signature(name: str, one: Callable[..., Any]) -> str:
    try:
        signature = inspect.signature(one)
    except (TypeError, ValueError):
        return _block(f"{name}(...)")
    kept = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
    back = "" if inspect.isclass(one) else f" -> {_plain(signature.return_annotation)}"
    shown = ", ".join(_parts(kept))
    if len(name) + len(shown) + len(back) < 90:
        return _block(f"{name}({shown}){back}")
    lines = "".join(f"    {part},\n" for part in _parts(kept))
    return _block(f"{name}(\n{lines}){back}")


def _parts(parameters: list[inspect.Parameter]) -> Iterator[str]:
    star = False
    for p in parameters:
        if p.kind is p.VAR_POSITIONAL:
            star = True
        if p.kind is p.KEYWORD_ONLY and not star:
            star = True
            yield "*"
        head = "*" if p.kind is p.VAR_POSITIONAL else "**" if p.kind is p.VAR_KEYWORD else ""
        default = "" if p.default is p.empty else f" = {_value(p.default)}"
        kind = "" if p.annotation is p.empty else f": {_plain(p.annotation)}"
        yield f"{head}{p.name}{kind}{default}"


def _value(default: Any) -> str:
    text = repr(default)
    if dataclasses.is_dataclass(default):
        return f"{type(default).__name__}()"
    if callable(default) or text.startswith("<"):  # a default factory, a function
        return "..."
    return text


def _plain(annotation: Any) -> str:
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    return re.sub(r"\b(?:[a-z_]+\.)+([A-Z])", r"\1", text)


def _returns(what: property) -> str:
    assert what.fget is not None
    return _plain(inspect.signature(what.fget).return_annotation)


def _code(text: str) -> str:
    return f"`{text}`"


def _block(text: str) -> str:
    return f"```python\n{text}\n```"


def docstring(one: Any) -> str:
    """The docstring that stands at an object itself, without indentation; "" for none."""
    text = getattr(one, "__doc__", None) or ""
    if dataclasses.is_dataclass(one) and text.startswith(f"{getattr(one, '__name__', '')}("):
        return ""  # made by dataclass
    return inspect.cleandoc(text)


_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Yields):$")
_ITEM = re.compile(r"^    (\*{0,2}[\w.]+(?:, \*{0,2}[\w.]+)*): (.*)$")


def described(one: Any) -> str:
    """A docstring as Markdown: sections become lists."""
    lines = _marked(docstring(one)).splitlines()
    made: list[str] = []
    section = ""
    for line in lines:
        found = _SECTION.match(line)
        if found:
            section = found[1]
            made += ["", f"**{_TITLES[section]}**", ""]
        elif not section:
            made.append(line)
        elif item := _ITEM.match(line):
            names = ", ".join(f"`{name}`" for name in item[1].split(", "))
            made.append(f"- {names}: {item[2]}")
        elif line.strip():
            made.append(f"  {line.strip()}" if made[-1].startswith(("- ", "  ")) else line.strip())
        else:
            made.append("")
        if section and line and not line.startswith(" ") and not found:
            section = ""
            made[-1] = line
    return re.sub(r"\n{3,}", "\n\n", "\n".join(line.rstrip() for line in made)).strip()


_TITLES = {"Args": "Parameters", "Attributes": "Attributes", "Returns": "Returns",
           "Raises": "Raises", "Yields": "Yields"}  # fmt: skip


def _marked(text: str) -> str:
    """References and double backquotes of docstrings as code of Markdown."""
    text = re.sub(r":(?:class|func|meth|mod|attr):`~?([^`]+)`", r"`\1`", text)
    return re.sub(r"``([^`]+)``", r"`\1`", text)


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), "utf-8")
