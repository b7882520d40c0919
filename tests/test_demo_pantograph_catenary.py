"""The pantograph demo in full: the standard's ranges. Its small version: tests/test_demos.py."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def run(tmp_path: Path, *flags: str) -> list[dict]:  # type: ignore[type-arg]
    file = tmp_path / "out.json"
    command = [sys.executable, "demos/pantograph_catenary.py", "--json", str(file), *flags]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=590)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(file.read_text())["check"]  # type: ignore[no-any-return]


@pytest.mark.slow
@pytest.mark.serial
def test_standard_ranges(tmp_path: Path) -> None:
    checks = run(tmp_path)
    assert len(checks) == 20 and all(c["ok"] for c in checks)
