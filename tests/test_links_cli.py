"""`pamrig links`: prints, refuses in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from bench_process import call_pamrig
from plant.links import dynamics as dyn
from plant.links import load_arm


def links(tmp_path: Path, *words: str) -> subprocess.CompletedProcess[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PAMRIG_CACHE", str(tmp_path))
        return call_pamrig("links", *words)


def test_text_is_the_default(tmp_path: Path) -> None:
    done = links(tmp_path, "finger")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("finger: q1 abduction, q2 flexion, q3 middle, q4 tip\n")


def test_the_python_it_prints_runs_alone(tmp_path: Path) -> None:
    """In a process that has nothing of ours: only numpy."""
    done = links(tmp_path, "planar2", "--print", "python")
    assert done.returncode == 0, done.stderr
    (tmp_path / "equations.py").write_text(done.stdout)
    alone = subprocess.run(
        [
            sys.executable,
            "-c",
            "import equations; print(*equations.inverse_dynamics((0.1, 0.2), (1, 2), (3, 4)))",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    ours = [float(word) for word in alone.stdout.split()]
    theirs = dyn.inverse_dynamics(load_arm("planar2"), [0.1, 0.2], [1, 2], [3, 4])
    assert ours == pytest.approx(list(theirs), rel=1e-12)


def test_latex(tmp_path: Path) -> None:
    done = links(tmp_path, "planar3", "--print", "latex")
    assert done.returncode == 0, done.stderr
    assert r"\ddot q_{3} &=" in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("fingr",), "did you mean finger?"),
        (("finger", "--print", "maple"), "choose one of text, latex, python"),
        (("nowhere/arm.toml",), "cannot be read"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    done = links(tmp_path, *words)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_body_that_cannot_be_is_named_with_its_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "mine"\ngravity_m_s2 = [0, 0, 0]\n[[link]]\njoint = "knee"\na_mm = 50\n'
        "mass_g = 10\ncom_mm = [-25, 0, 0]\ninertia_g_mm2 = [1, 1, 9, 0, 0, 0]\n"
    )
    done = links(tmp_path, str(path))
    assert done.returncode == 2
    assert f"{path}, link 1 (knee)" in done.stderr
    assert "not a valid inertia" in done.stderr


def test_without_sympy_it_says_what_to_install(tmp_path: Path) -> None:
    code = (
        "import importlib.metadata as m, sys\n"
        "def gone(name, real=m.version):\n"
        "    if name == 'sympy': raise m.PackageNotFoundError(name)\n"
        "    return real(name)\n"
        "m.version = gone\n"
        "sys.argv = ['pamrig', 'links', 'finger']\n"
        "from cli.main import main; main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 2
    assert "pip install 'pamrig[symbolic]'" in done.stderr
