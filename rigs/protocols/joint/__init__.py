"""Tests of a joint between two muscles."""
