"""What is installed: the wheel and the source archive hold all that a run needs; recipes say the same version and packages."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "fmbd_fenicsx"
SCRIPT = """
import fmbd_fenicsx as fmbd
arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0)))
run = fmbd.solve(scene, t_end=0.1, dt=0.01, output=fmbd.Output(snapshots=3))
run.animate("arm.html")
print(fmbd.__file__)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel and a source archive, built from a copy without what git does not know."""
    pytest.importorskip("setuptools")
    folder = tmp_path_factory.mktemp("built")
    copy = folder / "clone"
    copy.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    shutil.copytree(PACKAGE, copy / "fmbd_fenicsx", ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    code = f"from setuptools import build_meta as b; b.build_wheel({str(folder)!r}); b.build_sdist({str(folder)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=copy, check=True, capture_output=True, timeout=200)
    return folder


def needed() -> set[str]:
    """Files of the package that are not Python but belong to it."""
    kinds = {".c", ".h", ".pyi", ".html", ".typed"}
    return {str(p.relative_to(ROOT)) for p in PACKAGE.rglob("*") if p.suffix in kinds} | {"fmbd_fenicsx/py.typed"}


@pytest.mark.serial
def test_wheel_and_source_archive_hold_kernels_stubs_and_viewer(built: Path) -> None:
    wheel = set(zipfile.ZipFile(next(built.glob("*.whl"))).namelist())
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        source = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    python = {str(p.relative_to(ROOT)) for p in PACKAGE.rglob("*.py")}
    assert "fmbd_fenicsx/post/viewer.html" in needed() and len(python) > 100
    for kind, names in (("wheel", wheel), ("source archive", source)):
        assert not (needed() | python) - names, f"missing in the {kind}"


@pytest.mark.serial
def test_installed_wheel_runs_away_from_the_clone(built: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyvista")
    place = tmp_path / "installed"
    zipfile.ZipFile(next(built.glob("*.whl"))).extractall(place)
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(place)!r})\n{SCRIPT}"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)  # noqa: PLW1510
    assert done.returncode == 0, done.stderr[-2000:]
    assert str(place) in done.stdout and (tmp_path / "arm.html").exists()


def test_recipes_name_the_version_and_what_is_needed() -> None:
    recipe = (ROOT / "env/conda/meta.yaml").read_text()
    assert f'version: "{fmbd.__version__}"' in recipe
    yaml = pytest.importorskip("yaml")
    run = " ".join(yaml.safe_load(recipe)["requirements"]["run"])
    for package in ("fenics-dolfinx", "petsc4py", "mpi4py", "gmsh", "numpy", "scipy"):
        assert package in run


def test_dockerfile_has_known_instructions_only() -> None:
    lines = (ROOT / "env/Dockerfile").read_text().replace("\\\n", " ").splitlines()
    steps = [line.split()[0] for line in lines if line.strip() and not line.startswith("#")]
    assert steps[0] == "FROM" and set(steps) <= {"FROM", "RUN", "COPY", "WORKDIR", "CMD"}
    assert not re.search(r"pip install(?![^&]*--no-deps)[^&]*fmbd", " ".join(lines)), "pip must not fetch DOLFINx"
