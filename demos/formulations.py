"""Formulations: one elastic pendulum as rigid body, beam, reduced, floating and absolute body; error against run time.

Run:  ./with-dolfinx python3 demos/formulations.py            (--fast: coarse; --picture formulations.png)

The scene is the same for all: a rod on a pin under gravity. Reference: the absolute body, nonlinear, with steps a quarter as
long. The first table answers whether a linear floating frame is enough. The second has the floating body as its reference, in the
same frame and with the same steps, so that only the choice of modes counts: the error falls with every mode, slowly with
free-free modes, fast once the static modes of the pin carry what the joint does to the rod (Craig-Bampton).
"""

from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.faces.study import Configuration

ROD = Path(__file__).resolve().parents[1] / "meshes/rod.py"
E, NU, RHO, L, HEIGHT = 2e7, 0.3, 1000.0, 1.0, 0.1  # Pa, -, kg/m^3, m, m

MODES = [2, 4, 8, 16, 32]


def formulations(h):
    """Name -> body and the names of its two ends."""
    mesh = fmbd.read_gmsh(ROD, dim=2, h=h, length=L, height=HEIGHT)
    rod = fmbd.FloatingBody("rod", mesh, density=RHO, elastic=fmbd.materials.plane_stress(E, NU))
    energy = fmbd.materials.sheet_saint_venant_kirchhoff(E, NU)
    section = fmbd.Section.rectangle(youngs_modulus=E, poisson_ratio=NU, density=RHO, width=1.0, height=HEIGHT)
    found = {
        "rigid": rod.reduced(modes=0),
        "beam": fmbd.Beam("rod", (0.0, 0.0), (L, 0.0), section, attached=False, modes=12),
        **{f"reduced, {m} modes": rod.reduced(modes=m) for m in (4, 8, 16, 32)},
        "floating": rod,
        "absolute": fmbd.AbsoluteBody("rod", mesh, density=RHO, energy=energy),
    }
    return {k: (b, *(("start", "end") if k == "beam" else ("pin", "tip"))) for k, b in found.items()}


def swing(body, pin, tip, dt, t_end):
    """The pendulum's run; not a line of it knows the formulation."""
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface(pin)))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    return fmbd.solve(scene, t_end=t_end, dt=dt, output=fmbd.Output(energy=False, estimate_error=False))


def main():
    args = demo.arguments(__doc__)
    bodies, dt, t_end = formulations(0.1 if args.fast else 0.05), 2e-3, 0.25 if args.fast else 1.0
    repeats = 1 if args.fast else 3
    table = fmbd.study.work_precision(
        [Configuration(k, lambda h, b=b: swing(*b, h, t_end), [dt]) for k, b in bodies.items()],
        reference=swing(*bodies["absolute"], dt / 4, t_end),
        names=["tip"],
        repeats=repeats,
    )
    rod, full = bodies["floating"][0], swing(*bodies["floating"], dt, t_end)
    bases = {
        "free-free modes": {m: rod.reduced(modes=m) for m in MODES},
        "the pin's static modes, and": {m: rod.reduced(basis=fmbd.CraigBampton(("pin",), m)) for m in MODES},
    }
    modes = fmbd.study.work_precision(
        [Configuration(k, lambda m, b=b: swing(b[int(m)], "pin", "tip", dt, t_end), MODES) for k, b in bases.items()],
        reference=full,
        names=["tip"],
        repeats=repeats,
    )
    demo.say(f"{table}\n\n{modes}")
    errors = {p.label: p.errors["tip"] for p in table.points}
    free, static = np.reshape([p.errors["tip"] for p in modes.points], (2, -1))
    checks = [
        demo.Check("floating against absolute (small strain)", errors["floating"], 0.0, 3e-3),
        demo.Check("beam against floating", errors["beam"], errors["floating"], 3e-4),
        demo.Check("rigid is worse than 4 modes", float(errors["rigid"] > errors["reduced, 4 modes"]), 1.0, 0.0),
        demo.Check("more modes, less error", float((np.diff([free, static]) < 0).all()), 1.0, 0.0),
        demo.Check("16 free-free modes against floating (m)", free[MODES.index(16)], 0.0, 3e-4),
        demo.Check("static modes and 8 against floating (m)", static[MODES.index(8)], 0.0, 1e-5),
    ]
    if args.picture:
        from fmbd_fenicsx.faces.plot import plot_curves

        seconds = {p.label: 1e3 * p.seconds / p.counters["steps"] for p in table.points}
        points = {k: (np.array([seconds[k]]), np.array([errors[k]])) for k in bodies}
        plot_curves(points, args.picture, ("time per step (ms)", "largest tip error (m)"), log=True)
    demo.finish(checks, full, args)


if __name__ == "__main__":
    main()
