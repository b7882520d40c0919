"""A plugin of pytest that ends a session, between two tests, once it has used an amount of CPU time, and kills a test that hangs.

``CPU_BUDGET`` in the environment is the amount in seconds. A single test that takes as much again is ended by the system with
SIGXCPU. Time that other programs take from the machine does not count.
"""

from __future__ import annotations

import os
import resource
import time

import pytest

BUDGET = float(os.environ.get("CPU_BUDGET", "inf"))
GRACE = 2  # times the budget that one test may take


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A limit of the system's own for the test that begins."""
    if BUDGET < float("inf"):
        most = int(time.process_time() + GRACE * BUDGET) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (most, resource.getrlimit(resource.RLIMIT_CPU)[1]))


def pytest_runtest_teardown(item: pytest.Item) -> None:
    """Stop where the amount is used up; what was red stays red."""
    if time.process_time() > BUDGET:
        item.session.shouldstop = "CPU time spent"
