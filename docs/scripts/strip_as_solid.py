"""The thin strip that buckles sideways: as a rod, and as a solid of the same data in absolute coordinates.

Run:  ./with-dolfinx python3 docs/scripts/strip_as_solid.py          (--cells 16 1 3; --step 1e-3)

Crank, link, joints and drive: ``demos/rod_frame_model.py``. The stiffnesses given there are those of 100 mm x 10 mm of a material
with 73 GPa, 0.3 and 2680 kg/m^3. The solid is Saint-Venant and Kirchhoff's, of hexahedra of degree 2; its ends are held on
average, so that they may warp as sections of rods do.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd

sys.path.append(str(Path(__file__).parents[2] / "demos"))
from rod_frame_model import strip  # noqa: E402

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--cells", type=int, nargs=3, default=(16, 1, 3))
parser.add_argument("--step", type=float, default=1e-3)
parser.add_argument("--until", type=float, default=0.2)
args = parser.parse_args()


def solid():
    """The strip of 1 m x 10 mm x 100 mm along x, y, z."""
    mesh = fmbd.read_gmsh(
        "meshes/block.py", size=(1.0, 0.01, 0.1), counts=tuple(args.cells), origin=(0.0, -0.005, -0.05), quads=True
    )
    return fmbd.AbsoluteBody(
        "strip", mesh, degree=2, density=2680.0, energy=fmbd.materials.saint_venant_kirchhoff(73e9, 0.3)
    )


def solved(scene, step):
    """The run, and its CPU time, s."""
    start = time.process_time()
    run = fmbd.solve(scene, t_end=args.until, dt=step, scheme=fmbd.GeneralizedAlpha(0.5))
    return run, time.process_time() - start


def compare(label, one, other):
    """Largest differences along the motion over the largest values of the second, and instants of buckling."""
    lines = []
    for what, name, axis in (
        ("mid span sideways", "middle", 1),
        ("tip sideways", "tip", 1),
        ("tip upwards", "tip", 2),
        ("torque", "torque", 0),
    ):
        a, b = np.interp(other.times, one.times, one[name].reshape(len(one.times), -1)[:, axis]), other[name]
        b = b.reshape(len(other.times), -1)[:, axis]
        rms = np.linalg.norm(a - b) / np.linalg.norm(b - b[0])
        lines.append(f"{what} {np.abs(a).max():.5g} | {np.abs(b).max():.5g}, apart {rms:.2%} rms")
    fmbd.say(f"{label}: " + "; ".join(lines))


rod, cpu = solved(strip(6)[0], args.step)
finer, _ = solved(strip(8)[0], args.step / 2)
body, long = solved(strip(4, solid())[0], args.step)
compare("rod, twice the elements and half the step against one", finer, rod)
compare("solid against rod", body, rod)
for t in np.arange(0.05, args.until + 1e-9, 0.025):
    fmbd.say(f"t {t:.3f}: " + ", ".join(f"{np.interp(t, r.times, r['middle'][:, 1]):.6f}" for r in (rod, finer, body)))
fmbd.say(f"CPU: rod {cpu:.1f} s, solid {long:.1f} s")
