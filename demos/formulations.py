"""Formulations: one elastic pendulum as rigid body, beam, reduced, floating and absolute body; error against run time.

Run:  ./with-dolfinx python3 demos/formulations.py            (--fast: coarse; --picture formulations.png)

The scene is the same for all: a rod on a pin under gravity. Reference: the absolute body, nonlinear, with steps a quarter as
long. The table answers whether a linear floating frame is enough, and how many modes are.
"""

from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

ROD = Path(__file__).resolve().parents[1] / "meshes/rod.py"
E, NU, RHO, L, HEIGHT = 2e7, 0.3, 1000.0, 1.0, 0.1  # Pa, -, kg/m^3, m, m


def formulations(h):
    """Name -> body and the names of its two ends."""
    mesh = fmbd.read_gmsh(ROD, dim=2, h=h, length=L, height=HEIGHT)
    rod = fmbd.FloatingBody("rod", mesh, density=RHO, elastic=fmbd.materials.plane_stress(E, NU))
    energy = fmbd.materials.sheet_saint_venant_kirchhoff(E, NU)
    section = fmbd.Section.rectangle(
        youngs_modulus=E, poisson_ratio=NU, density=RHO, width=1.0, height=HEIGHT
    )
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
    exact = swing(*bodies["absolute"], dt / 4, t_end)["tip"][::4]
    errors, times = {}, {}
    demo.say(f"{'formulation':<20}{'tip error (m)':>15}{'ms / step':>11}{'set-up (s)':>12}{'iterations':>12}")
    for name, body in bodies.items():
        run = swing(*body, dt, t_end)
        errors[name] = float(np.abs(run["tip"] - exact).max())
        times[name] = 1e3 * run.seconds["steps"] / run.counters["steps"]
        iterations = run.counters["newton_iterations"] / run.counters["steps"]
        demo.say(
            f"{name:<20}{errors[name]:>15.2e}{times[name]:>11.3f}{run.seconds['set-up']:>12.2f}{iterations:>12.2f}"
        )
    checks = [
        demo.Check("floating against absolute (small strain)", errors["floating"], 0.0, 3e-3),
        demo.Check("16 modes against floating", errors["reduced, 16 modes"], errors["floating"], 3e-4),
        demo.Check("beam against floating", errors["beam"], errors["floating"], 3e-3),
        demo.Check(
            "rigid is worse than 4 modes", float(errors["rigid"] > errors["reduced, 4 modes"]), 1.0, 0.0
        ),
    ]
    if args.picture:
        from fmbd_fenicsx.plot import plot_curves

        points = {k: (np.array([times[k]]), np.array([errors[k]])) for k in bodies}
        plot_curves(points, args.picture, ("time per step (ms)", "largest tip error (m)"), log=True)
    demo.finish(checks, run, args)


if __name__ == "__main__":
    main()
