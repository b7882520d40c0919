"""No access beside the arrays that the driver was given: its tests once more, compiled with the compiler's address sanitizer."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = (
    "driver",
    "driver_start",
    "compiled",
    "compiled_absolute",
    "compiled_contact",
    "compiled_elastic_contact",
    "contact_candidates",
    "contact_heaps",
    "controllers",
    "delassus",
    "memory_orders",
    "compiled_control",
    "compiled_evaluation",
    "compiled_means",
    "compiled_parts",
    "compiled_recording",
    "compiled_stiffening",
    "compiled_ties",
    "explicit_fields",
    "field_means",
    "field_stages",
    "field_states",
    "kept_steps",
    "moreau",
    "redundancy",
    "rods_relaxation",
    "marches",
    "stage_systems",
    "stiff_ties",
    "steps_one_by_one",
    "checkpoint",
    "substructures",
    "sums",
    "whole_forces",
    "wires",
)


def library(name: str) -> str:
    """The path of a library of the C compiler; "" without one."""
    try:
        found = subprocess.run(
            ["gcc", f"-print-file-name={name}"], capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""
    return found if Path(found).is_absolute() else ""


SANITIZER, STANDARD = library("libasan.so"), library("libstdc++.so")


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.timeout(0)
@pytest.mark.skipif(not (SANITIZER and STANDARD), reason="no address sanitizer")
def test_the_driver_stays_in_its_memory(tmp_path: Path) -> None:
    """The first access outside ends the process; Python's own allocator, which hides them, is left out."""
    environment = {
        **os.environ,
        "CC": "cc -g -fsanitize=address",
        "XDG_CACHE_HOME": str(tmp_path / "cache"),  # FFCx would keep such forms for others
        "LD_PRELOAD": f"{SANITIZER} {STANDARD}",
        "ASAN_OPTIONS": f"detect_leaks=0:log_path={tmp_path / 'found'}",
        "PYTHONMALLOC": "malloc",
        "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "tests"))),
    }
    options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", f"--basetemp={tmp_path / 'tests'}", "--timeout=900"]
    files = [f"tests/test_{name}.py" for name in FILES]
    command = [sys.executable, "-m", "pytest", *options, *files]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)

    reports = [x.read_text() for x in tmp_path.glob("found.*")]
    assert not reports and done.returncode == 0, "\n".join(reports) or done.stdout[-3000:]
