"""What reduced runs state of their own error of reduction, beside the error against the whole field (docs/flexible.md).

Run:  ./with-dolfinx python3 docs/scripts/reduction_error.py            (a minute of CPU time)

Scenes: a soft rod on a pin under gravity that is there at once or grows within 0.3 s, in the plane and in space, and the rod of
demos/slider_crank_fe.py, run up to 150 rad/s. Ratio: stated over true error, the largest over the run.
"""

import sys
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.study import aligned

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "demos"))
import crank_fe_model as crank  # noqa: E402


def pendulum(body, ramp):
    """A rod on a pin; position of the tip, reaction of the pin."""
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[: body.dim], gravity_ramp=ramp)
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    scene.sensor("reaction", fmbd.reaction_force("pin"))
    return scene


def rod(dim, h):
    """A soft rod, 1 m x 0.1 m."""
    elastic = fmbd.materials.plane_stress(2e7, 0.3) if dim == 2 else fmbd.materials.linear_elastic(2e7, 0.3)
    mesh = fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=dim, h=h, length=1.0, height=0.1)
    return fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=elastic)


def bases(body, surfaces, counts):
    """Name -> reduced body."""
    kinds = {
        "free-free modes": lambda n: body.reduced(modes=n),
        "static and": lambda n: body.reduced(basis=fmbd.CraigBampton(surfaces, n)),
        "static, inertia and": lambda n: body.reduced(basis=fmbd.CraigBampton(surfaces, n, inertia=True)),
    }
    return {f"{kind} {n}": make(n) for kind, make in kinds.items() for n in counts}


def table(title, scene, bodies, full, *, names, t_end, dt):
    """Print true and stated errors of one scene."""
    output = fmbd.Output(energy=False, estimate_reduction=True)
    exact = fmbd.solve(scene(full), t_end=t_end, dt=dt, output=output)
    rows = [[title, *(c for n in names for c in (n, "stated", "ratio"))]]
    for label, body in bodies.items():
        run = fmbd.solve(scene(body), t_end=t_end, dt=dt, output=output)
        pairs = [(float(np.abs(run[n] - exact[n]).max()), run.reduction_error[n]) for n in names]
        rows.append([label, *(c for e, s in pairs for c in (f"{e:.1e}", f"{s:.1e}", f"{s / e:.2f}"))])
    fmbd.say(aligned(rows) + "\n")


def main():
    """All tables."""
    flat, solid, link = rod(2, 0.1), rod(3, 0.25), crank.rod(0.02, 0.01)
    held, counts = ("pin",), (0, 2, 4, 8, 16, 32)
    short = {"names": ("tip", "reaction"), "t_end": 1.0, "dt": 2e-3}
    table("pendulum, let go", lambda b: pendulum(b, 0.0), bases(flat, held, counts), flat, **short)
    table("pendulum, gravity in 0.3 s", lambda b: pendulum(b, 0.3), bases(flat, held, counts), flat, **short)
    table("in space, gravity in 0.3 s", lambda b: pendulum(b, 0.3), bases(solid, held, (4, 16)), solid, **short)
    turning = {"names": ("side", "knee force"), "t_end": crank.END, "dt": crank.TURN / 200}
    table("slider crank", crank.scene, bases(link, crank.BORES, (0, 4, 16)), link, **turning)


if __name__ == "__main__":
    main()
