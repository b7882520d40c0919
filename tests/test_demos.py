"""Every demo runs in its fast version, in serial and on two ranks, and passes its own checks with the same
figures."""

import ast
import json
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from demo_process import run_copy
from programs import ROOT, run_on_ranks

DEMOS = sorted(p for p in (ROOT / "demos").glob("*.py") if "finish(" in p.read_text())


def run(demo: Path, file: Path, ranks: int = 1) -> dict[str, float]:
    """Run a demo as a program of its own; the values of its checks by name."""
    command = [sys.executable, str(demo), "--fast", "--json", str(file)]
    done = run_on_ranks(ranks, command, timeout=280)
    return passed(done.returncode, done.stdout + done.stderr, file)


def passed(code: int, output: str, file: Path) -> dict[str, float]:
    """The values of a demo's checks by name; all of them hold."""
    assert code == 0, output[-3000:]
    checks = json.loads(file.read_text())["check"]
    assert checks and all(c["ok"] for c in checks)
    assert output.count(f"check {checks[0]['name']}:") == 1, "printed once, whatever the number of ranks"
    return {c["name"]: c["value"] for c in checks}


MARKS = {
    "elastic_pendulum": pytest.mark.smoke,
    "robot_arm": pytest.mark.skipif(find_spec("yourdfpy") is None, reason="no yourdfpy"),
}
PARAMETERS = [pytest.param(p, marks=MARKS.get(p.stem, ()), id=p.stem) for p in DEMOS]


@pytest.mark.serial
@pytest.mark.parametrize("demo", PARAMETERS)
def test_demo_passes_its_checks(demo, tmp_path):
    file = tmp_path / "one.json"
    code, output = run_copy(demo, ["--fast", "--json", str(file)], tmp_path)
    passed(code, output, file)


@pytest.mark.serial
def test_a_demo_is_a_program(tmp_path):
    """In a process that has loaded nothing."""
    run(ROOT / "demos/elastic_pendulum.py", tmp_path / "one.json")


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun")
@pytest.mark.parametrize("demo", PARAMETERS)
def test_demo_has_the_same_figures_on_two_ranks(demo, tmp_path):
    one = run(demo, tmp_path / "one.json")
    two = run(demo, tmp_path / "two.json", ranks=2)
    assert two == pytest.approx(one, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("demo", DEMOS, ids=lambda p: p.stem)
def test_demo_says_how_to_run_it(demo):
    text = ast.get_docstring(ast.parse(demo.read_text())) or ""
    assert f"./with-dolfinx python3 demos/{demo.name}" in text
