"""Random mutants: one operator, constant, term, sign, bound, comparison or statement changed at a time, in any folder.

Run:  ./with-dolfinx python3 tests/random_mutants.py 200 --seed 1         draws, tries, prints each, and the share caught
      ./with-dolfinx python3 tests/random_mutants.py 200 --seed 1 --list  prints the mutants only
      ./with-dolfinx python3 tests/random_mutants.py 200 --seed 1 --found FILE   keeps what is found, and goes on from there

A mutant is caught when one of the tests that speak most of its module turns red, or else one of the smoke set (:func:`tests_of`).
They get an amount of CPU time, not of time: a loaded machine finds the same. Survivors are read by hand: those that change
nothing that could be seen are equivalent; the others are gaps (docs/mutations.md).
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "fmbd_fenicsx"
TESTS = ROOT / "tests"
CPU = 90  # s of CPU time for the tests of one mutant, and as much for the smoke set
WALL = 3600  # s after which tests that wait for each other are ended; such a mutant is caught
FILES = 10  # test files of a mutant at most
FARTHER = 0.3  # what words of a module count for those that it imports

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


# -- which tests ----------------------------------------------------------------------------------------------------
@cache
def words_of_tests() -> dict[str, frozenset[str]]:
    """The words of every test file, those of its name too."""
    return {
        f"tests/{path.name}": frozenset(re.findall(r"[A-Za-z]\w+", path.read_text()))
        | {*path.stem.split("_"), path.stem[5:]}
        for path in sorted(TESTS.glob("test_*.py"))
    }


@cache
def words_of_module(path: Path) -> frozenset[str]:
    """Names of a module's functions and classes, and its own."""
    kinds = ast.FunctionDef | ast.ClassDef
    names = {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, kinds)}
    return frozenset(n for n in names if not n.startswith("__")) | {path.stem}


@cache
def importers() -> dict[Path, set[Path]]:
    """The modules that import a module, lazily too."""
    found: dict[Path, set[Path]] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.ImportFrom) or not node.level:
                continue
            base = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            for target in [base, *(base / alias.name for alias in node.names)]:
                if target.with_suffix(".py").exists():
                    found.setdefault(target.with_suffix(".py"), set()).add(path)
    return found


def tests_of(mutant: Mutant) -> list[str]:
    """The test files that speak most of a mutant's module.

    A word counts by how few test files have it: the mutant's function and its module in full, other names of the module for
    less, names of modules that import it, and of their importers, for still less.
    """
    known = Counter(word for words in words_of_tests().values() for word in words)
    weights = {word: FARTHER for word in words_of_module(mutant.path)} | {mutant.function: 1.0, mutant.path.stem: 1.0}
    near, share = {mutant.path}, FARTHER
    for _ in range(2):
        near, share = {up for path in near for up in importers().get(path, ())}, FARTHER * share
        for word in {word for path in near for word in words_of_module(path)}:
            weights.setdefault(word, share)

    scores = {
        file: sum(weights[w] / known[w] for w in words & weights.keys()) for file, words in words_of_tests().items()
    }
    ranked = sorted((file for file in scores if scores[file] > 0), key=lambda file: -scores[file])
    return ranked[:FILES]


# -- trying them ----------------------------------------------------------------------------------------------------
def caught(copy: Path, mutant: Mutant) -> str:
    """The first test that turns red, "" for none."""
    where = copy / mutant.path.relative_to(ROOT)
    where.write_text(mutant.source)
    try:
        return _first_red(copy, tests_of(mutant)) or _first_red(copy, ["-m", "smoke"])
    finally:
        where.write_text(mutant.path.read_text())


def _first_red(copy: Path, selection: list[str]) -> str:
    """The first test that turns red within the CPU time; "it hangs" where one test takes all of a second one."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "--tb=no",
        "-p",
        "no:cacheprovider",
        "-p",
        "cpu_budget",
        *selection,
    ]
    path = os.pathsep.join((str(copy), str(copy / "tests")))
    environment = {**os.environ, "PYTHONPATH": path, "CPU_BUDGET": str(CPU), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=copy, env=environment, timeout=WALL)  # noqa: PLW1510
    except subprocess.TimeoutExpired:
        return "it hangs"
    red = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if red:
        return red.group(1)
    if done.returncode < 0:
        return "it hangs"
    spent = "CPU time spent" in done.stdout
    return "" if spent or done.returncode in (0, 5) else "the suite does not start"


def main() -> int:
    """Draw, try and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--found", type=Path)
    wanted = parser.parse_args()

    drawn = draw(wanted.count, wanted.seed)
    if wanted.list:
        print(*drawn, sep="\n")
        return 0

    found = json.loads(wanted.found.read_text()) if wanted.found is not None and wanted.found.exists() else {}
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".mypy_cache"))
        for k, mutant in enumerate(drawn):
            if str(mutant) in found:
                continue
            red = found[str(mutant)] = caught(copy, mutant)
            print(f"{k:3} {mutant}: {red or 'NOT CAUGHT'}", flush=True)
            if wanted.found is not None:
                wanted.found.write_text(json.dumps(found, indent=0))
    survivors = sum(not found[str(mutant)] for mutant in drawn)
    print(f"{len(drawn) - survivors} of {len(drawn)} caught (seed {wanted.seed})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
