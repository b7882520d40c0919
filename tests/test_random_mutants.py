"""The search for places that no test watches: what it draws, which tests see which lines, and that red tests are seen."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mutations import MUTATIONS
from random_mutants import PACKAGE, ROOT, Case, draw
from random_mutants import tests_of as likely

KINDS = {"operator", "term dropped", "constant", "sign", "bound", "comparison", "statement"}


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation[0])
def test_lines_that_are_broken_by_hand_are_there(mutation: tuple[str, str, str, str, list[str]]) -> None:
    """One of each in its file, and the tests that are to see it."""
    _, name, line, _, tests = mutation
    assert (PACKAGE / name).read_text().count(line) == 1
    assert all((ROOT / f"tests/{test}.py").exists() for test in tests)


def test_a_seed_says_what_is_drawn() -> None:
    first, again, other = draw(300, 1), draw(300, 1), draw(300, 2)
    assert [str(m) for m in first] == [str(m) for m in again] != [str(m) for m in other]
    assert {m.kind for m in first} == KINDS
    rooms = {path.parent for path in PACKAGE.rglob("*.py") if path.name != "__init__.py"}
    assert len({m.path.parent for m in first} & rooms) > 0.8 * len(rooms)


def test_a_mutant_changes_one_place() -> None:
    for mutant in draw(30, 3, "linear"):
        assert mutant.path.is_relative_to(PACKAGE / "linear")
        before, after = mutant.path.read_text(), mutant.source
        assert ast.dump(ast.parse(before)) != ast.dump(ast.parse(after))
        lines = before.split("\n")
        assert lines[: mutant.lines.start - 1] == after.split("\n")[: mutant.lines.start - 1]
        assert mutant.lines.start in range(1, len(lines)) and mutant.function in before


def test_likely_tests_come_first() -> None:
    (mutant,) = draw(1, 1, "rotations.py")
    line = 1 << mutant.lines.start
    tests = [
        Case("tests/test_a.py::elsewhere", 0.01, {"mesh.py": 6}),
        Case("tests/test_a.py::long", 5.0, {"rotations.py": line}),
        Case("tests/test_rotations.py::own", 0.1, {"rotations.py": line}),
        Case("tests/test_b.py::short", 0.1, {"rotations.py": line}),
    ]
    assert [t.name.split("::")[1] for t in likely(mutant, tests)] == ["own", "short", "long", "elsewhere"]


@pytest.mark.serial
@pytest.mark.slow
def test_mutants_of_rotations_are_caught(tmp_path: Path) -> None:
    """From the map of lines to the share: two tests of rotations kill what is drawn there."""
    path = os.pathsep.join((str(ROOT), str(ROOT / "tests")))
    environment = {**os.environ, "PYTHONPATH": path, "LINE_MAP": str(tmp_path)}
    names = ["test_rate_inverts_the_tangent", "test_exponential_is_that_of_the_skew_matrix"]
    chosen = [f"tests/test_rotations.py::{name}" for name in names]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "line_map", "-p", "no:cacheprovider", *chosen]
    subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True)

    (file,) = tmp_path.glob("*.jsonl")
    entries = [json.loads(line) for line in file.read_text().splitlines()]
    assert [e["test"].split("[")[0] for e in entries][0] == chosen[0] and entries[0]["lines"]["rotations.py"]

    trying = [sys.executable, "tests/random_mutants.py", "3", "--only", "rotations.py", "--map", str(tmp_path)]
    found = subprocess.run(trying, cwd=ROOT, env=environment, check=True, capture_output=True, text=True).stdout
    assert "tests/test_rotations.py::" in found and "caught (seed 1)" in found, found
