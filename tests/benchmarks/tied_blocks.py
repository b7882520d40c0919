"""Two tied blocks on meshes that do not match, in scikit-fem and GetFEM and here: error and CPU time on the same meshes.

Run:  ./with-dolfinx python3 tests/benchmarks/tied_blocks.py [--skfem PYTHON] [--getfem PYTHON] [--cells 8]

PYTHON are interpreters that have the peers (also: the variables SKFEM_PYTHON, GETFEM_PYTHON), say
    python3 -m venv peers && peers/bin/pip install scikit-fem; Debian's python3-getfem
The smooth solution of ``demos/blocks_model.py``, meshes of 7 n and 5 n cells. All outer faces are held: by multipliers here,
eliminated there. CPU seconds from the mesh to the solution, the median of three, forms compiled before. One thread.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "demos"))
PEERS = {"skfem": "SKFEM_PYTHON", "getfem": "GETFEM_PYTHON"}


def write_meshes(n, file):
    """Points and triangles of both blocks for the peers; the meshes for this package."""
    import fmbd_fenicsx as fmbd

    blocks = ((7 * n, 1.0), (5 * n, 0.0))
    made = [fmbd.read_gmsh(ROOT / "meshes/block.py", cells=c, origin=(0.0, y)) for c, y in blocks]
    arrays = {}
    for k, m in enumerate(made):
        arrays[f"p{k}"] = m.dolfinx.geometry.x[:, :2].T
        arrays[f"t{k}"] = np.asarray(m.dolfinx.geometry.dofmap).T
    np.savez(file, **arrays)
    return made


def ours(degree, meshes):
    """Errors of u in L2 and H1, CPU seconds."""
    import blocks_model as model

    seconds = []
    for _ in range(4):
        start = time.process_time()
        found = model.solve(degree, meshes, model.BEND)
        seconds.append(time.process_time() - start)
    return [*model.errors(found, model.BEND), median(seconds[1:])]


def compare(cells, degrees=(1, 2), pythons=None):
    """Rows: degree, who, errors, seconds, ratios of error and time to ours."""
    pythons = pythons or {name: os.environ.get(variable, "") for name, variable in PEERS.items()}
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "meshes.npz"
        meshes = write_meshes(cells, file)
        for degree in degrees:
            mine = ours(degree, meshes)
            rows.append((degree, "fmbd_fenicsx", *mine, 1.0, 1.0))
            for peer, python in pythons.items():
                if not python:
                    continue
                command = [python, str(Path(__file__).with_name("tied_blocks_peers.py")), str(file), str(degree), peer]
                done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
                found = json.loads(done.stdout.splitlines()[-1])
                rows.append((degree, peer, *found[:3], found[0] / mine[0], found[2] / mine[2]))
    return rows


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--cells", type=int, default=8)
    for name, variable in PEERS.items():
        words.add_argument(f"--{name}", default=os.environ.get(variable, ""))
    args = words.parse_args()
    print("degree, who, u L2, u H1, CPU s, error over ours, time over ours")
    for row in compare(args.cells, pythons={name: getattr(args, name) for name in PEERS}):
        print(f"P{row[0]}  {row[1]:<13}  {row[2]:.3e}  {row[3]:.3e}  {row[4]:7.3f}  {row[5]:6.3f}  {row[6]:6.2f}")
