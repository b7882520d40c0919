"""Random mutants: one operator, constant, term, sign, bound, comparison or statement changed at a time, in any folder.

Run:  ./with-dolfinx python3 tests/random_mutants.py 200 --seed 1         draws, tries, prints each, and the share caught
      ./with-dolfinx python3 tests/random_mutants.py 200 --seed 1 --list  prints the mutants only

A mutant is caught when a test of those that import or name its module turns red, or else one of the smoke set. Survivors are
read by hand: those that change nothing that could be seen are equivalent; the others are gaps (docs/mutations.md).
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "fmbd_fenicsx"
SECONDS = 600  # for the tests of one mutant; one that hangs is caught

SWAPS: dict[type, type] = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
TURNS: dict[type, type] = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt}
BOUNDS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}


@dataclass(frozen=True)
class Mutant:
    """One changed place: file, function, line, kind of change, the new text of the file."""

    path: Path
    function: str
    line: int
    kind: str
    source: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(PACKAGE)}:{self.line} {self.function}: {self.kind}"


def places(tree: ast.AST) -> Iterator[tuple[ast.AST, str, ast.AST]]:
    """(node, kind of change, what replaces it) of every change that can be made within a function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp) and type(node.op) in SWAPS:
            yield node, "operator", ast.BinOp(node.left, SWAPS[type(node.op)](), node.right)
            if isinstance(node.op, ast.Add | ast.Sub):
                yield node, "term dropped", node.left
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node, "constant", ast.Constant(2 * node.value if node.value else 1)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield node, "sign", node.operand
        if isinstance(node, ast.Name) and node.id in BOUNDS:
            yield node, "bound", ast.Name(BOUNDS[node.id], ast.Load())
        if isinstance(node, ast.Attribute) and node.attr in BOUNDS:
            yield node, "bound", ast.Attribute(node.value, BOUNDS[node.attr], ast.Load())
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in TURNS:
            yield node, "comparison", ast.Compare(node.left, [TURNS[type(node.ops[0])]()], node.comparators)
        if isinstance(node, ast.AugAssign | ast.Expr) and not isinstance(node.value, ast.Constant | ast.Yield):
            yield node, "statement", ast.Pass()


def mutants_of(path: Path) -> list[Mutant]:
    """Every mutant of a file, outside messages and annotations."""
    text = path.read_text()
    found = []
    for function in ast.walk(ast.parse(text)):
        if not isinstance(function, ast.FunctionDef):
            continue
        silent = {id(c) for n in ast.walk(function) if isinstance(n, ast.JoinedStr | ast.Raise) for c in ast.walk(n)}
        silent |= {id(c) for a in ast.walk(function) if isinstance(a, ast.arg) for c in ast.walk(a)}
        for node, kind, new in places(function):
            if id(node) not in silent:
                found.append(Mutant(path, function.name, node.lineno, kind, _replaced(text, node, new)))
    return found


def _replaced(text: str, node: ast.AST, new: ast.AST) -> str:
    """The text with the node's source replaced."""
    lines = text.encode().split(b"\n")
    first, last = node.lineno - 1, node.end_lineno - 1
    code = ast.unparse(ast.fix_missing_locations(new))
    if not isinstance(new, ast.stmt):
        code = f"({code})"
    head, tail = lines[first][: node.col_offset], lines[last][node.end_col_offset :]
    return b"\n".join([*lines[:first], head + code.encode() + tail, *lines[last + 1 :]]).decode()


def draw(count: int, seed: int) -> list[Mutant]:
    """Mutants of all folders, at most one of a function."""
    chance = random.Random(seed)
    pool = [m for path in sorted(PACKAGE.rglob("*.py")) for m in mutants_of(path)]
    chance.shuffle(pool)
    drawn: dict[tuple[Path, str], Mutant] = {}
    for mutant in pool:
        drawn.setdefault((mutant.path, mutant.function), mutant)
    return list(drawn.values())[:count]


def tests_of(path: Path) -> list[str]:
    """Test files that import or name a module, those named like it first."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    dotted, name = ".".join(parts), parts[-1]
    files = sorted((ROOT / "tests").glob("test_*.py"))
    files = [f for f in files if re.search(rf"{re.escape(dotted)}\b", f.read_text()) or f.stem == f"test_{name}"]
    return [f"tests/{f.name}" for f in sorted(files, key=lambda f: f.stem != f"test_{name}")]


def caught(copy: Path, mutant: Mutant) -> str:
    """The first test that turns red, "" for none."""
    where = copy / mutant.path.relative_to(ROOT)
    where.write_text(mutant.source)
    try:
        own = tests_of(mutant.path)
        for selection in ([*own] if own else [], ["-m", "smoke"]):
            found = _first_red(copy, selection) if selection else ""
            if found:
                return found
        return ""
    finally:
        where.write_text(mutant.path.read_text())


def _first_red(copy: Path, selection: list[str]) -> str:
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--tb=no", "-p", "no:cacheprovider", *selection]
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=copy, env=environment, timeout=SECONDS)  # noqa: PLW1510
    except subprocess.TimeoutExpired:
        return "it hangs"
    red = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if red:
        return red.group(1)
    return "" if done.returncode in (0, 5) else "the suite does not start"


def main() -> int:
    """Draw, try and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", action="store_true")
    wanted = parser.parse_args()

    drawn = draw(wanted.count, wanted.seed)
    if wanted.list:
        print(*drawn, sep="\n")
        return 0

    survivors = 0
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", "docs", ".mypy_cache"))
        for k, mutant in enumerate(drawn):
            red = caught(copy, mutant)
            survivors += not red
            print(f"{k:3} {mutant}: {red or 'NOT CAUGHT'}", flush=True)
    print(f"{len(drawn) - survivors} of {len(drawn)} caught (seed {wanted.seed})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
