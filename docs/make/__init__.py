"""Generators of the reference pages and of the documentation site; not part of the wheel."""
