"""Ask this python for DOLFINx, and complete it by what the tests and pictures need.

    PYTHON env/native.py VENV

Nothing is changed in PYTHON's own installation: VENV is a venv on top of it, with only those extras from PyPI
that are missing.  DOLFINx, PETSc, MPI are never fetched.  VENV/found is written last, with three lines for
`with-dolfinx`: the folder of DOLFINx, that of PYTHON, and the major version of Open MPI (empty: another MPI).
"""

import importlib.util
import os
import pathlib
import re
import shutil
import site
import subprocess
import sys

EXTRAS = {  # module: name on PyPI
    "gmsh": "gmsh",
    "scipy": "scipy",
    "matplotlib": "matplotlib",
    "pyvista": "pyvista",
    "tqdm": "tqdm",
    "mypy": "mypy",
    "pytest": "pytest",
    "pytest_timeout": "pytest-timeout",
    "xdist": "pytest-xdist",
    "hypothesis": "hypothesis",
}


def say(text):
    """Tell what goes on, where it does not mix with the command's output."""
    print("with-dolfinx:", text, file=sys.stderr, flush=True)


def check():
    """Refuse a DOLFINx that cannot serve, and return its folder and numpy's version."""
    import dolfinx
    import numpy
    from petsc4py import PETSc

    if tuple(int(n) for n in re.findall(r"\d+", dolfinx.__version__)[:2]) < (0, 9):
        sys.exit(f"with-dolfinx: DOLFINx {dolfinx.__version__} of {sys.executable} is older than 0.9")
    if numpy.issubdtype(PETSc.ScalarType, numpy.complexfloating):
        sys.exit(f"with-dolfinx: PETSc of {sys.executable} is built for complex numbers")
    say(f"using DOLFINx {dolfinx.__version__} of {sys.executable}")
    return os.path.dirname(dolfinx.__file__), numpy.__version__


def make_venv(venv, numpy_version):
    """Make the venv on top of this python, with what is missing; what cannot be had is told and left out."""
    shutil.rmtree(venv, ignore_errors=True)
    subprocess.run([sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", venv], check=True)
    python = str(venv / "bin" / "python3")
    if sys.prefix != sys.base_prefix:  # a venv over a venv sees only the packages of the python below both
        (packages,) = venv.glob("lib/python3*/site-packages")
        (packages / "below.pth").write_text("\n".join(site.getsitepackages()) + "\n")
    missing = [pip for module, pip in EXTRAS.items() if not importlib.util.find_spec(module)]
    if missing and not importlib.util.find_spec("pip"):
        subprocess.run([python, "-m", "ensurepip"], stdout=subprocess.DEVNULL)
    for name in missing:
        say(f"fetching {name} from PyPI into {venv}")
        command = [python, "-m", "pip", "install", "--quiet", name, f"numpy=={numpy_version}"]
        if subprocess.run(command, stdout=sys.stderr).returncode:
            say(f"cannot have {name}, going on without")
    for name in "pytest", "mypy":  # plain words, whatever the command is called there
        word = venv / "bin" / name
        if not word.exists():
            word.write_text(f'#!/bin/sh\nexec python3 -m {name} "$@"\n')
            word.chmod(0o755)


def open_mpi():
    """Major version of the mpirun that belongs to this python, or nothing."""
    path = os.path.dirname(sys.executable) + os.pathsep + os.environ.get("PATH", "")
    mpirun = shutil.which("mpirun", path=path)
    answer = subprocess.run([mpirun, "--version"], capture_output=True, text=True).stdout if mpirun else ""
    match = re.search(r"\(Open MPI\) (\d+)", answer)
    return match.group(1) if match else ""


if __name__ == "__main__":
    venv = pathlib.Path(sys.argv[1])
    folder, numpy_version = check()
    make_venv(venv, numpy_version)
    (venv / "found.part").write_text(f"{folder}\n{os.path.dirname(sys.executable)}\n{open_mpi()}\n")
    os.replace(venv / "found.part", venv / "found")
