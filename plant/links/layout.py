"""Sizes of the arrays that the compiled functions of `plant.links.kernel` work in."""

from __future__ import annotations

WORK = 8
"""Columns of the work space, one row per link: cosine, sine, force F (3), moment N (3)."""
