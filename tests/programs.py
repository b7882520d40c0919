"""Programs that tests start: a Python script on so many ranks, from the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def launch(code: str, ranks: int, *words: str, timeout: float = 240.0) -> subprocess.CompletedProcess[str]:
    """Run a script on so many ranks; both streams, exit code."""
    return run_on_ranks(ranks, [sys.executable, "-c", code, *words], timeout)


def run_on_ranks(ranks: int, command: list[str], timeout: float) -> subprocess.CompletedProcess[str]:
    """Run a program on so many ranks, with a temporary folder of its own.

    Open MPI keeps a folder there that is named by the number of its process, leaves it behind when a rank ends all, and refuses
    to start where it finds one.
    """
    if ranks > 1:
        command = [_runner(), "-n", str(ranks), *command]
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM", "PMIX", "PMI_"))}
    with tempfile.TemporaryDirectory(prefix="fmbd", ignore_cleanup_errors=True) as own:
        env = {**inherited, "TMPDIR": own}
        return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=timeout, env=env)  # noqa: PLW1510


def _runner() -> str:
    runner = shutil.which("mpirun") or shutil.which("mpiexec")
    if runner is None:
        pytest.skip("no mpirun here")
    return runner
