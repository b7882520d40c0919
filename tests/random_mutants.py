"""Random mutants: one operator, constant, term, sign, bound, comparison or statement changed at a time, in any folder.

Run:  ./with-dolfinx python3 tests/random_mutants.py 200 --seed 1 --list       prints the mutants only
      ./with-dolfinx python3 tests/random_mutants.py 200 --seed 1 --map DIR    draws, tries, prints each, and the share caught

``DIR`` holds which lines every test runs (``tests/line_map.py``); where it is missing the suite is run once to make it. ``--found
FILE`` keeps what is found and goes on from there: survivors are tried on further tests where ``--seconds`` is larger than before.
``--only PATH`` draws from one file or folder of the package.

A mutant is tried in a copy of the project on the tests that run its line, then on those that run its function, its module,
cheap ones that run little else first (:func:`tests_of`). They get an amount of CPU time, not of time: a loaded machine finds the
same. A test that is red without the mutant too does not count. Survivors are read by hand: those that change nothing that
could be seen are equivalent; the others are gaps (docs/mutations.md).
"""

from __future__ import annotations

import argparse
import ast
import compileall
import json
import os
import py_compile
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import forked_tests

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "fmbd_fenicsx"
TESTS = ROOT / "tests"
FIRST = 4.0  # s of CPU time for the first tests of a mutant; then as much again as was spent
OWN = 0.2  # how much of their effort counts of tests that bear the module's name

SWAPS: dict[type, type] = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
TURNS: dict[type, type] = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt}
BOUNDS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}


@dataclass(frozen=True)
class Mutant:
    """One changed place: file, function, kind of change, lines of the function and of the file, what replaces what."""

    path: Path
    function: str
    kind: str
    around: range
    module: range
    node: Any
    new: Any

    @property
    def lines(self) -> range:
        """The lines of the changed place."""
        return range(self.node.lineno, self.node.end_lineno + 1)

    @property
    def source(self) -> str:
        """The new text of the file."""
        return _replaced(self.path.read_text(), self.node, self.new)

    def __str__(self) -> str:
        return f"{self.path.relative_to(PACKAGE)}:{self.lines.start} {self.function}: {self.kind}"


def places(tree: ast.AST) -> Iterator[tuple[Any, str, Any]]:
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


@cache
def mutants_of(path: Path) -> list[Mutant]:
    """Every mutant of a file, outside messages and annotations."""
    text = path.read_text()
    found = []
    for function in ast.walk(ast.parse(text)):
        if not isinstance(function, ast.FunctionDef):
            continue
        silent = {id(c) for n in ast.walk(function) if isinstance(n, ast.JoinedStr | ast.Raise) for c in ast.walk(n)}
        silent |= {id(c) for a in ast.walk(function) if isinstance(a, ast.arg) for c in ast.walk(a)}
        around = range(function.body[0].lineno, (function.end_lineno or 0) + 1)
        for node, kind, new in places(function):
            if id(node) not in silent:
                found.append(Mutant(path, function.name, kind, around, range(text.count("\n") + 1), node, new))
    return found


def _replaced(text: str, node: Any, new: Any) -> str:
    """The text with the node's source replaced."""
    lines = text.encode().split(b"\n")
    first, last = node.lineno - 1, node.end_lineno - 1
    code = ast.unparse(ast.fix_missing_locations(new))
    if not isinstance(new, ast.stmt):
        code = f"({code})"
    head, tail = lines[first][: node.col_offset], lines[last][node.end_col_offset :]
    return b"\n".join([*lines[:first], head + code.encode() + tail, *lines[last + 1 :]]).decode()


def draw(count: int, seed: int, only: str = "") -> list[Mutant]:
    """Mutants of all folders, or of one file or folder only; at most one of a function."""
    chance = random.Random(seed)
    paths = [path for path in sorted(PACKAGE.rglob("*.py")) if path.is_relative_to(PACKAGE / only)]
    pool = [m for path in paths for m in mutants_of(path)]
    chance.shuffle(pool)
    drawn: dict[tuple[Path, str], Mutant] = {}
    for mutant in pool:
        drawn.setdefault((mutant.path, mutant.function), mutant)
    return list(drawn.values())[:count]


# -- which tests ----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Case:
    """A test: its name, CPU time in s, and the lines of the package that it runs, by file: bit n of a number for line n."""

    name: str
    seconds: float
    lines: dict[str, int]

    @cached_property
    def effort(self) -> float:
        """What ranks tests: time, and how much else they run."""
        return (self.seconds + 0.05) * (200 + sum(map(int.bit_count, self.lines.values())))

    @property
    def function(self) -> str:
        """Its name without parameters."""
        return self.name.split("[")[0]


def make_map(folder: Path) -> None:
    """Run the default suite once and write which lines its tests run."""
    folder.mkdir(parents=True)
    path = os.pathsep.join((str(ROOT), str(ROOT / "tests")))
    environment = {**os.environ, "PYTHONPATH": path, "LINE_MAP": str(folder.resolve())}
    subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "line_map"], cwd=ROOT, env=environment, check=False)


def read_map(folder: Path) -> list[Case]:
    """The tests that were run."""
    entries = [json.loads(line) for file in sorted(folder.glob("*.jsonl")) for line in file.read_text().splitlines()]
    return [Case(e["test"], e["seconds"], {f: _bits(n) for f, n in e["lines"].items()}) for e in entries]


def _bits(lines: Iterable[int]) -> int:
    return sum(1 << n for n in set(lines))


def tests_of(mutant: Mutant, tests: list[Case]) -> list[Case]:
    """The tests that may see a mutant, the likeliest and cheapest first.

    First those that run its line, then its function, then the other tests of their files (what a fixture of a file runs is known
    of one test only), then those that run the module or its folder (what is generated once and kept is run by none). Among
    these, tests that bear its name count for less effort, further cases of the same test for more.
    """
    file = mutant.path.relative_to(PACKAGE)
    own = (f"tests/test_{file.stem}.py", f"tests/test_{file.parent.name}.py")

    def near(lines: range) -> list[Case]:
        return [test for test in tests if test.lines.get(str(file), 0) & _bits(lines)]

    groups = [near(mutant.lines), near(mutant.around)]
    files = {test.name.split("::")[0] for test in groups[1]}
    groups += [[test for test in tests if test.name.split("::")[0] in files], near(mutant.module)]
    groups += [[test for test in tests if any(Path(other).parent == file.parent for other in test.lines)]]

    chosen: dict[str, Case] = {}
    for group in groups:
        seen: Counter[str] = Counter()
        ranks = {}
        for test in sorted(group, key=lambda test: test.effort):
            seen[test.function] += 1
            ranks[test.name] = test.effort * seen[test.function] * (OWN if test.name.startswith(own) else 1)
        for test in sorted(group, key=lambda test: ranks[test.name]):
            chosen.setdefault(test.name, test)
    return list(chosen.values())


# -- trying them ----------------------------------------------------------------------------------------------------
@dataclass
class Trial:
    """What is known of a mutant: the test that turned red, how many were run, and their CPU time in s."""

    red: str = ""
    tests: int = 0
    seconds: float = 0.0


class Judge:
    """Tries mutants in one copy of the project; knows which tests are red there without any.

    Args:
        scratch: an empty folder.
        tests: what :func:`read_map` has read.
    """

    def __init__(self, scratch: Path, tests: list[Case]) -> None:
        self.copy = scratch / "copy"
        self.tests = tests
        self.red: set[str] = set()
        self.green: set[str] = set()

        shutil.copytree(ROOT, self.copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".mypy_cache"))
        compileall.compile_dir(
            self.copy / "fmbd_fenicsx", quiet=1, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH
        )
        self._keep_own_kernels(scratch / "cache")
        forked_tests.load_libraries()

    def _keep_own_kernels(self, cache: Path) -> None:
        """What mutants compile must not be found by others."""
        kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fenics"
        if kept.is_dir():
            shutil.copytree(kept, cache / "fenics")
        os.environ |= {"XDG_CACHE_HOME": str(cache), "XDG_STATE_HOME": str(cache / "state"), "OMP_NUM_THREADS": "1"}

    def look(self, mutant: Mutant, known: Trial, most: float) -> Trial:
        """Go on with a mutant until a test turns red, or all are run, or ``most`` s are spent."""
        order = tests_of(mutant, self.tests)
        trial = known
        while trial.tests < len(order) and trial.seconds < most and not trial.red:
            batch = _batch(order[trial.tests :], max(FIRST, trial.seconds))
            trial = self._tried(mutant, batch, trial, most - trial.seconds)
        return trial

    def _tried(self, mutant: Mutant, batch: list[Case], known: Trial, most: float) -> Trial:
        """Try some more tests."""
        chosen = {test.name: test.seconds for test in batch if test.name not in self.red}
        if not chosen:
            return Trial("", known.tests + len(batch), known.seconds)
        where = self.copy / mutant.path.relative_to(ROOT)
        where.write_text(mutant.source)
        try:
            report = forked_tests.run(self.copy, chosen, most)
        finally:
            where.write_text(mutant.path.read_text())

        red = report.red
        if red and not self._stands(red, {name: chosen[name] for name in report.begun}):
            return Trial("", known.tests, known.seconds + report.seconds)

        names = [test.name for test in batch]
        done = 1 + max((names.index(name) for name in report.begun), default=len(names) - 1)
        finished = len(names) if len(report.begun) == len(chosen) else done
        return Trial(red, known.tests + finished, round(known.seconds + report.seconds, 1))

    def _stands(self, red: str, begun: dict[str, float]) -> bool:
        """Whether the tests that were begun are green without the mutant; the red one is not asked again otherwise."""
        last = list(begun)[-1:]
        if not last or last[0] in self.green:
            return True
        control = forked_tests.run(self.copy, begun)
        (self.red if control.red else self.green).update(last)
        if control.red:
            print(f"    red without a mutant too: {red}", flush=True)
        return not control.red


def _batch(tests: list[Case], seconds: float) -> list[Case]:
    """The first tests that should take so many s together, one at least."""
    ends = list(accumulate(test.seconds for test in tests))
    return tests[: 1 + sum(end < seconds for end in ends)]


def main() -> int:
    """Draw, try and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--map", type=Path, default=Path("line_map"))
    parser.add_argument("--found", type=Path)
    wanted = parser.parse_args()

    drawn = draw(wanted.count, wanted.seed, wanted.only)
    if wanted.list:
        print(*drawn, sep="\n")
        return 0

    if not wanted.map.exists():
        make_map(wanted.map)
    found = json.loads(wanted.found.read_text()) if wanted.found is not None and wanted.found.exists() else {}
    with tempfile.TemporaryDirectory() as scratch:
        judge = Judge(Path(scratch), read_map(wanted.map))
        for k, mutant in enumerate(drawn):
            known = Trial(**found.get(str(mutant), {}))
            trial = judge.look(mutant, known, wanted.seconds)
            found[str(mutant)] = asdict(trial)
            if trial != known:
                print(
                    f"{k:3} {mutant}: {trial.red or 'NOT CAUGHT'} ({trial.tests} tests, {trial.seconds} s)", flush=True
                )
            if wanted.found is not None:
                wanted.found.write_text(json.dumps(found, indent=0))

    survivors = sum(not found[str(mutant)]["red"] for mutant in drawn)
    print(f"{len(drawn) - survivors} of {len(drawn)} caught (seed {wanted.seed})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
