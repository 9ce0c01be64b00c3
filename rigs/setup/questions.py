"""Questions with defaults, answered at a terminal, by a file or by options."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from typing import Any

from daq.errors import ConfigError

Say = Callable[[str], None]
Read = Callable[[str], str]
"""Shows a prompt and returns the line that was typed. Raises EOFError at the end of the input."""


class Interview:
    """Asks one question after the other; an empty answer takes the default.

    Args:
        given: answers that are known already, by key; these questions are not asked.
        source: where they come from, for messages.
        say: shows a line; None shows nothing.
        read: reads an answer; None takes the default of each question.

    Attributes:
        answers: every answer so far, given, typed or by default, in the order of the questions.
    """

    def __init__(
        self,
        given: Mapping[str, Any] | None = None,
        source: str = "answers",
        say: Say | None = None,
        read: Read | None = None,
    ) -> None:
        self._given = dict(given or {})
        self._source = source
        self._say = say
        self._read = read
        self.answers: dict[str, Any] = {}

    def tell(self, *lines: str) -> None:
        """Show lines."""
        for line in lines:
            if self._say is not None:
                self._say(line)

    def choice(self, key: str, text: str, choices: Mapping[str, str], default: str) -> str:
        """One of some words.

        Args:
            key: name of the answer.
            text: the question.
            choices: word to what it means.
            default: one of the words.

        Raises:
            ConfigError: a given answer is none of the words.
        """
        words = list(choices)

        def parse(value: Any) -> str:
            word = str(value).strip()
            if word.isdigit() and 1 <= int(word) <= len(words):
                word = words[int(word) - 1]
            if word not in choices:
                near = difflib.get_close_matches(word, words, n=1)
                hint = f"did you mean {near[0]!r}?" if near else ""
                raise ValueError(f"{word!r} is not one of {', '.join(words)}; {hint}".rstrip("; "))
            return word

        if self._asked(key):
            wide = max(map(len, words))
            self.tell("", f"{text}")
            for number, word in enumerate(words, 1):
                self.tell(f"  {number}  {word.ljust(wide)}  {choices[word]}")
            return str(self._answer(key, f"{key}", default, parse))
        return str(self._answer(key, text, default, parse))

    def number(
        self, key: str, text: str, default: float, low: float, high: float, unit: str = ""
    ) -> float:
        """A number from ``low`` to ``high``.

        Raises:
            ConfigError: a given answer is no such number.
        """
        named = f" {unit}" if unit else ""

        def parse(value: Any) -> float:
            try:
                number = float(str(value)) if not isinstance(value, bool) else math.nan
            except ValueError:
                number = math.nan
            if not low <= number <= high:
                raise ValueError(f"expected a number from {low:g} to {high:g}{named}, got {value}")
            return number

        return float(self._answer(key, f"{text}{',' if unit else ''}{named}", default, parse))

    def numbers(
        self, key: str, text: str, default: tuple[float, ...], low: float, high: float, unit: str
    ) -> tuple[float, ...]:
        """One or more numbers, separated by commas.

        Raises:
            ConfigError: a given answer is no such list.
        """

        def parse(value: Any) -> tuple[float, ...]:
            words = (
                value if isinstance(value, (list, tuple)) else str(value).strip("[] ").split(",")
            )
            try:
                found = tuple(float(word) for word in words)
            except ValueError:
                found = ()
            if not found or not all(low <= number <= high for number in found):
                raise ValueError(
                    f"expected numbers from {low:g} to {high:g} {unit}, separated by commas,"
                    f" got {value}"
                )
            return found

        shown = ", ".join(f"{number:g}" for number in default)
        return tuple(self._answer(key, f"{text}, {unit}", default, parse, shown))

    def text(
        self, key: str, text: str, default: str, check: Callable[[str], str] | None = None
    ) -> str:
        """Text; ``check`` returns what is wrong with it, or "".

        Raises:
            ConfigError: a given answer is refused.
        """

        def parse(value: Any) -> str:
            word = str(value).strip()
            wrong = check(word) if check is not None else ""
            if not word.isprintable() or '"' in word or "\\" in word:
                wrong = f"{word!r}: expected printable text without quotes and backslashes"
            if wrong:
                raise ValueError(wrong)
            return word

        return str(self._answer(key, text, default, parse))

    def yes_no(self, key: str, text: str, default: bool) -> bool:
        """Yes or no.

        Raises:
            ConfigError: a given answer is neither.
        """

        def parse(value: Any) -> bool:
            if isinstance(value, bool):
                return value
            word = str(value).strip().lower()
            if word not in ("y", "yes", "true", "n", "no", "false"):
                raise ValueError(f"expected yes or no, got {value!r}")
            return word[0] in "yt"

        return bool(self._answer(key, text, default, parse, "yes" if default else "no"))

    def gave(self, key: str) -> bool:
        """Whether the answer to a question is known already."""
        return key in self._given

    def finish(self, more: tuple[str, ...] = ()) -> None:
        """Refuse a given answer that no question asked for; ``more`` are keys that were left out.

        Raises:
            ConfigError: names the first one.
        """
        for key in self._given:
            if key not in self.answers:
                known = (*self.answers, *more)
                near = difflib.get_close_matches(key, known, n=1)
                raise ConfigError(
                    f"{self._source}: {key}",
                    "no question has that key here",
                    f"did you mean {near[0]!r}?" if near else f"asked were: {', '.join(known)}",
                )

    def _asked(self, key: str) -> bool:
        return key not in self._given and self._read is not None

    def _answer(
        self,
        key: str,
        text: str,
        default: Any,
        parse: Callable[[Any], Any],
        shown: str | None = None,
    ) -> Any:
        if key in self._given:
            try:
                self.answers[key] = parse(self._given[key])
            except ValueError as error:
                raise ConfigError(f"{self._source}: {key}", str(error)) from None
            return self.answers[key]
        self.answers[key] = default
        if self._read is not None:
            self.answers[key] = self._typed(key, text, default, parse, shown)
        return self.answers[key]

    def _typed(
        self,
        key: str,
        text: str,
        default: Any,
        parse: Callable[[Any], Any],
        shown: str | None,
    ) -> Any:
        assert self._read is not None
        shown = f"{default:g}" if isinstance(default, float) and shown is None else shown
        while True:
            try:
                line = self._read(f"{text} [{default if shown is None else shown}]: ").strip()
            except EOFError:
                raise ConfigError(
                    f"question {key!r}",
                    "the input ended before its answer",
                    "add --yes to take the defaults of what is left",
                ) from None
            if not line:
                return default
            try:
                return parse(line)
            except ValueError as error:
                self.tell(f"  {error}")
