"""Tests of a copy of the project, run in a fork of a process that has loaded all libraries: a second less each time.

The process itself must never load the package: each child loads the copy as it is then.
"""

from __future__ import annotations

import importlib
import os
import resource
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

import pytest

LIBRARIES = (
    *(
        "numpy",
        "scipy.sparse.linalg",
        "scipy.linalg",
        "scipy.integrate",
        "scipy.optimize",
        "mpi4py.MPI",
        "petsc4py.PETSc",
    ),
    *("ufl", "basix.ufl", "ffcx", "dolfinx", "dolfinx.fem.petsc", "gmsh", "hypothesis", "pytest_timeout"),
)
PATIENCE = 60  # s of CPU time that one test may take beyond ten times what it should: it may have a form to compile


@dataclass(frozen=True)
class Report:
    """What came of some tests: the first that turned red ("" for none), those that were begun, CPU time in s."""

    red: str
    begun: list[str]
    seconds: float


def load_libraries() -> None:
    """Load all that the children share."""
    for name in LIBRARIES:
        importlib.import_module(name)


def run(copy: Path, tests: dict[str, float], most: float = float("inf")) -> Report:
    """Run tests of a copy in their order until one turns red or ``most`` s of CPU time are spent.

    Args:
        copy: the folder of the project's copy.
        tests: names of tests, with the CPU time in s that each should take.
        most: no further test begins later; other programs that tests start count, what others take from the machine does not.
    """
    notes = copy.parent / "notes.txt"
    notes.write_text("")

    child = os.fork()
    if not child:
        _run_as_child(copy, tests, most, notes)
    _, status, used = os.wait4(child, 0)

    told = [line.split(" ", 1) for line in notes.read_text().splitlines()]
    begun = [name for what, name in told if what == "begun"]
    red = next((name for what, name in told if what == "red"), "")

    if not red and os.WIFSIGNALED(status):
        red = f"{begun[-1] if begun else 'the suite'} hangs or crashes"
    elif not red and os.waitstatus_to_exitcode(status) not in (0, 2, 5):
        red = "the suite does not start"
    return Report(red, begun, used.ru_utime + used.ru_stime)


def _run_as_child(copy: Path, tests: dict[str, float], most: float, notes: Path) -> None:
    """Run pytest in the copy; never returns."""
    code = 1
    try:
        os.chdir(copy)
        sys.dont_write_bytecode = True
        sys.path[:0] = [str(copy), str(copy / "tests")]
        os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:2])

        silence = os.open(copy.parent / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(silence, stream)

        files = sorted({name.split("::")[0] for name in tests})
        options = ["-q", "-x", "--timeout=900", "-p", "no:cacheprovider", f"--basetemp={copy.parent / 'tmp'}"]
        code = int(pytest.main([*options, *files], plugins=[Chosen(tests, most, notes)]))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


class Chosen:
    """A plugin of pytest that runs the chosen tests in the order given, and notes each at once: the process may be killed."""

    def __init__(self, tests: dict[str, float], most: float, notes: Path) -> None:
        self.tests = tests
        self.most = most
        self.notes = notes

    def _note(self, what: str, name: str) -> None:
        with self.notes.open("a") as target:
            target.write(f"{what} {name}\n")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        place = {name: k for k, name in enumerate(self.tests)}
        items[:] = sorted((x for x in items if x.nodeid in place), key=lambda x: place[x.nodeid])

    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self._note("begun", item.nodeid)
        most = int(time.process_time() + 10 * self.tests[item.nodeid] + PATIENCE)
        resource.setrlimit(resource.RLIMIT_CPU, (most, resource.getrlimit(resource.RLIMIT_CPU)[1]))

    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        times = os.times()
        if sum(times[:4]) > self.most:
            item.session.shouldstop = "CPU time spent"

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._note("red", report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._note("red", f"{report.nodeid} cannot be loaded")
