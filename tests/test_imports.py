"""What an import and a rigid scene load: nothing that they do not need."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.serial

RIGID = """
import numpy as np
import fmbd_fenicsx as fmbd
scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0)))
scene.sensor("tip", fmbd.position(arm))
run = fmbd.solve(scene, t_end=0.02, dt=0.01)
run.report()
"""


def loaded(code: str) -> dict[str, float]:
    """Top-level modules that a fresh interpreter has loaded after ``code``, and its seconds, by the clock and of work."""
    tail = (
        "\nimport sys, json\nprint(json.dumps({'seconds': time.perf_counter() - t0, 'work': time.process_time(), 'modules': "
        "sorted({m.split('.')[0] for m in sys.modules})}))"
    )
    done = subprocess.run(  # noqa: PLW1510
        [sys.executable, "-c", "import time; t0 = time.perf_counter()\n" + code + tail],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_package_loads_no_mesh_picture_or_eigenvalue_library() -> None:
    modules = set(loaded("import fmbd_fenicsx")["modules"])
    assert not modules & {"gmsh", "pyvista", "vtkmodules", "matplotlib", "slepc4py"}
    assert not modules & {"dolfinx", "petsc4py", "mpi4py", "ufl"}


def test_rigid_scene_loads_no_finite_elements_and_no_mpi() -> None:
    modules = set(loaded(RIGID)["modules"])
    assert not modules & {
        "dolfinx",
        "petsc4py",
        "mpi4py",
        "ufl",
        "basix",
        "gmsh",
        "pyvista",
        "matplotlib",
        "slepc4py",
    }


def test_rigid_scene_starts_in_less_work_than_two_imports_of_dolfinx() -> None:
    """Interpreter, import, set-up, two steps and the report take 1.25 of what DOLFINx takes to be imported; processor time."""
    pairs = [(loaded(RIGID)["work"], loaded("import dolfinx.fem")["work"]) for _ in range(3)]
    assert min(own for own, _ in pairs) < 1.8 * min(other for _, other in pairs)


def test_elastic_body_loads_no_pictures() -> None:
    modules = set(loaded("import fmbd_fenicsx as f; f.read_gmsh('meshes/rod.py', h=0.5)")["modules"])
    assert "dolfinx" in modules  # the probe sees what is there
    assert not modules & {"pyvista", "matplotlib", "slepc4py"}


def test_package_imports_about_as_fast_as_dolfinx() -> None:
    """Alone on the machine it takes two thirds of the time; beside other tests the two come near each other."""
    pairs = [(loaded("import fmbd_fenicsx")["seconds"], loaded("import dolfinx.fem")["seconds"]) for _ in range(5)]
    assert min(own for own, _ in pairs) < 1.3 * min(other for _, other in pairs)
