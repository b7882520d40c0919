"""A plugin of pytest that writes which lines of the package every test runs, and how long the test takes.

Run:  LINE_MAP=DIR ./with-dolfinx pytest -q -p line_map -n 2 --dist loadfile      (``tests`` on the path)

Each process writes ``DIR/<process>.jsonl``, a line for each test: its name, seconds of CPU time, and lines by file. What a
fixture of a whole file runs counts for the first test that needs it; programs that a test starts are not seen.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import CodeType
from typing import Any

import pytest

PACKAGE = str(Path(__file__).resolve().parents[1] / "fmbd_fenicsx") + os.sep
TOOL = sys.monitoring.COVERAGE_ID
seen: defaultdict[str, set[int]] = defaultdict(set)


def line_runs(code: CodeType, line: int) -> Any:
    """Keep the line; each is told once a test."""
    if PACKAGE and code.co_filename.startswith(PACKAGE):  # at the end of a process its globals may be gone
        seen[code.co_filename.removeprefix(PACKAGE)].add(line)
    return sys.monitoring.DISABLE


def pytest_configure(config: pytest.Config) -> None:
    """Ask the interpreter to tell lines."""
    sys.monitoring.use_tool_id(TOOL, "line_map")
    sys.monitoring.register_callback(TOOL, sys.monitoring.events.LINE, line_runs)
    sys.monitoring.set_events(TOOL, sys.monitoring.events.LINE)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Write the lines of a test, with those of the fixtures that it was the first to need."""
    seen.clear()
    sys.monitoring.restart_events()
    start = time.process_time()
    result = yield
    entry = {
        "test": item.nodeid,
        "seconds": round(time.process_time() - start, 3),
        "lines": {file: sorted(lines) for file, lines in seen.items()},
    }
    with (Path(os.environ["LINE_MAP"]) / f"{os.getpid()}.jsonl").open("a") as target:
        target.write(json.dumps(entry) + "\n")
    return result
