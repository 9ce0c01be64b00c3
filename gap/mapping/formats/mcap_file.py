"""MCAP files with messages in JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from gap.errors import GapError
from gap.mapping.formats.source import Column, first_line, library, plain, texts

MOST_MESSAGES = 20_000_000
_CHUNK = 256 << 20


class McapFile:
    """An MCAP file: a column is `topic:field`, fields within fields behind a dot.

    `own_ns` are the log times of the messages, from 1970.

    Raises:
        GapError: not such a file, or mcap is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._library = library("mcap.reader", path, "mcap")
        self._topics: dict[str, str] = {}
        try:
            with path.open("rb") as file:
                summary = self._library.make_reader(file).get_summary()
                if summary is None:
                    raise GapError(str(path), "has no summary", "recover it with `mcap recover`")
                for chunk in summary.chunk_indexes:
                    if chunk.uncompressed_size > _CHUNK:
                        raise GapError(str(path), f"has a chunk of {chunk.uncompressed_size} bytes")
                for channel in summary.channels.values():
                    self._topics[channel.topic] = channel.message_encoding
        except GapError:
            raise
        except Exception as error:  # the reader raises whatever it meets
            raise GapError(str(path), f"is not an MCAP file ({first_line(error)})") from None
        self._messages: dict[str, tuple[list[Any], list[int]]] = {}

    def names(self) -> list[str]:
        """Topics with the fields of their first message."""
        found = []
        for topic in self._topics:
            try:
                first = self._of(topic)[0][:1]
            except GapError:
                continue
            found += [f"{topic}:{field}" for field in _fields(first[0] if first else {}, "")]
        return found

    def column(self, name: str) -> Column:
        """One field of all messages of a topic."""
        where = f"{self._path}, column {name}"
        topic, _, field = name.partition(":")
        if topic not in self._topics or not field:
            known = ", ".join(self.names()[:12])
            raise GapError(where, "is missing", f"write topic:field; there are: {known}")
        messages, times = self._of(topic)
        values = [self._value(message, field, where, k) for k, message in enumerate(messages)]
        if any(isinstance(value, str) for value in values):
            return texts(where, values)
        numbers = np.array([np.nan if v is None else v for v in values], dtype=np.float64)
        whole = all(isinstance(value, (int, bool)) for value in values)
        made = np.array(values, dtype=np.int64) if whole and values else numbers
        return plain(where, made, own_ns=np.array(times, dtype=np.int64), dated=True)

    def _value(self, message: Any, field: str, where: str, index: int) -> Any:
        value = message
        for step in field.split("."):
            if isinstance(value, list) and step.isdecimal() and int(step) < len(value):
                value = value[int(step)]
            elif isinstance(value, dict) and step in value:
                value = value[step]
            else:
                raise GapError(f"{where}, message {index + 1}", f"has no field {field!r}")
        if isinstance(value, int) and abs(value) >= 2**63:
            raise GapError(f"{where}, message {index + 1}", "has more than 64 bits")
        if value is not None and not isinstance(value, (str, int, float)):
            raise GapError(f"{where}, message {index + 1}", "is neither a number nor a text")
        return value

    def _of(self, topic: str) -> tuple[list[Any], list[int]]:
        """Messages of a topic and their log times, ns."""
        if topic in self._messages:
            return self._messages[topic]
        if self._topics[topic] != "json":
            raise GapError(
                f"{self._path}, topic {topic}",
                f"is encoded as {self._topics[topic]!r}; only JSON is read",
                "convert the file, or export the topic to CSV",
            )
        found: tuple[list[Any], list[int]] = ([], [])
        try:
            with self._path.open("rb") as file:
                for _, _, message in self._library.make_reader(file).iter_messages(topics=[topic]):
                    found[0].append(json.loads(message.data))
                    found[1].append(int(message.log_time))
                    if len(found[0]) > MOST_MESSAGES:
                        raise GapError(str(self._path), f"has more than {MOST_MESSAGES} messages")
        except GapError:
            raise
        except Exception as error:  # damaged chunks, messages that are no JSON
            where = f"{self._path}, topic {topic}"
            raise GapError(where, f"cannot be read ({first_line(error)})") from None
        self._messages[topic] = found
        return found


def _fields(message: Any, prefix: str) -> list[str]:
    if isinstance(message, dict):
        return [
            name
            for key, value in message.items()
            for name in _fields(value, f"{prefix}.{key}" if prefix else str(key))
        ]
    return [prefix] if isinstance(message, (str, int, float)) else []
