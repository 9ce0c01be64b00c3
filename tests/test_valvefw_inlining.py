"""Constants of the firmware become numbers, and nothing else changes."""

from __future__ import annotations

import pytest

from rigs.bench.inlining import constants, inline

MODULES = {"valvefw.core": {"NOW": 0, "DT": 9}, "valvefw.wire": {"TICK_US": 1000}}


def test_only_public_integers_of_the_top_level_are_constants() -> None:
    source = "A = const(3)\nB = 4\n_C = 5\nd = 6\nE = 'x'\nF = True\nG = A\n\ndef f():\n    H = 7\n"
    assert constants(source) == {"A": 3, "B": 4}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (
            "from valvefw.core import DT, Core\ns[DT] = 1\n",
            "from valvefw.core import Core\ns[9] = 1\n",
        ),
        ("from valvefw.core import NOW\nx = s[NOW]\n", "\nx = s[0]\n"),
        ("from valvefw.core import DT\nx.DT = DT\n", "\nx.DT = 9\n"),
        ("from valvefw.core import DT\nt = 'DT'  # DT\n", "\nt = 'DT'  # DT\n"),
        ("from valvefw.core import DT as D\nx = D\n", "from valvefw.core import DT as D\nx = D\n"),
        ("N = const(7)\nx = N\n", "\nx = 7\n"),
        ("N = 7\nx = N + N\n", "N = 7\nx = N + N\n"),
    ],
)
def test_uses_become_numbers(source: str, expected: str) -> None:
    assert inline(source, MODULES) == expected
