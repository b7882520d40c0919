"""The crank against general DAE solvers, where an interpreter with scikit-sundae and scipy-dae is named by DAE_PYTHON."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = os.environ.get("DAE_PYTHON", "")


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(
    not PYTHON or shutil.which(PYTHON) is None, reason="DAE_PYTHON names no interpreter with general solvers"
)
def test_ggl_form_is_faster_than_the_best_general_solver(tmp_path: Path) -> None:
    """CPU time to 1e-9 rad in phi2, and to 1e-6 and 1e-8 in the elastic coordinates, all in one process."""
    out = tmp_path / "rows.json"
    command = [PYTHON, "tests/benchmarks/crank_solvers.py", "--json", str(out), "--repeats", "1"]
    environment = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'demos'}"}
    subprocess.run(command, cwd=ROOT, env=environment, check=True, timeout=3000)
    rows = json.loads(out.read_text())
    general = {r["label"] for r in rows if r["label"].startswith(("IDA", "scipy"))}
    assert general
    for kind, error in (("phi2", 1e-9), ("elastic", 1e-6), ("elastic", 1e-8)):

        def best(ours: bool, kind: str = kind, error: float = error) -> float:
            reached = [
                r["seconds"] for r in rows if (r["label"] not in general) is ours and r.get(kind, np.inf) <= error
            ]
            return min(reached, default=np.inf)

        assert best(True) < best(False), (kind, error, best(True), best(False))
