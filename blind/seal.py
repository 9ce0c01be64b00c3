"""Seal an answer: its salted SHA-256 goes out first, answer and salt only after the verdict."""

from __future__ import annotations

import hashlib
import json
import secrets
from typing import Any


def text_of(answer: dict[str, Any]) -> str:
    """The one way an answer is written down."""
    return json.dumps(answer, sort_keys=True, separators=(",", ":"), allow_nan=False)


def seal(answer: dict[str, Any], salt: str | None = None) -> tuple[str, dict[str, Any]]:
    """Digest to publish, and the envelope (answer with its salt) to keep closed."""
    grain = secrets.token_hex(16) if salt is None else salt
    digest = hashlib.sha256((grain + text_of(answer)).encode()).hexdigest()
    return digest, {"salt": grain, "answer": answer}


def opened(envelope: dict[str, Any], digest: str) -> dict[str, Any]:
    """The answer of an envelope, if it is the one sealed; ValueError otherwise."""
    answer = envelope["answer"]
    found, _ = seal(answer, envelope["salt"])
    if not secrets.compare_digest(found, digest):
        raise ValueError(f"the answer does not match its seal {digest[:12]}")
    return dict(answer)
