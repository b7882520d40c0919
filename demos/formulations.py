"""Formulations: one elastic pendulum as rigid body, beam, reduced, floating and absolute body; error against run time.

Run:  ./with-dolfinx python3 demos/formulations.py            (--fast: coarse; --picture formulations.png)

The scene is the same for all: a rod on a pin under gravity. Reference: the absolute body, nonlinear, with steps a quarter as
long. The first table answers whether a linear floating frame is enough. The second has the floating body as its reference, in the
same frame and with the same steps, so that only the choice of modes counts: the error falls with every mode, slowly with
free-free modes, fast once the static modes of the pin carry what the joint does to the rod (Craig-Bampton). Each of these runs
states the error of its modes itself, from a run with more of them, without the field.
"""

from itertools import pairwise
from pathlib import Path

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

ROD = Path(__file__).resolve().parents[1] / "meshes/rod.py"
E, NU, RHO, L, HEIGHT = 2e7, 0.3, 1000.0, 1.0, 0.1  # Pa, -, kg/m^3, m, m
MODES = (2, 4, 8, 16, 32)


def formulations(rod, energy):
    """Name -> body."""
    section = fmbd.Section.rectangle(youngs_modulus=E, poisson_ratio=NU, density=RHO, width=1.0, height=HEIGHT)
    return {
        "rigid": rod.reduced(modes=0),
        "beam, 12 modes": fmbd.Beam("rod", (0.0, 0.0), (L, 0.0), section, attached=False, modes=12),
        **{f"reduced, {m} modes": rod.reduced(modes=m) for m in (4, 8, 16, 32)},
        "floating": rod,
        "absolute": fmbd.AbsoluteBody("rod", rod.mesh, density=RHO, energy=energy),
    }


def swing(body, dt, t_end, states_error=False):
    """The pendulum's run; not a line of it knows the formulation."""
    pin, tip = ("start", "end") if isinstance(body, fmbd.Beam) else ("pin", "tip")
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface(pin)))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    output = fmbd.Output(energy=False, estimate_reduction=states_error)
    return fmbd.solve(scene, t_end=t_end, dt=dt, output=output)


def main():
    args = demo.arguments(__doc__)
    h, dt, t_end, repeats = (0.1, 2e-3, 0.25, 1) if args.fast else (0.05, 2e-3, 1.0, 3)
    mesh = fmbd.read_gmsh(ROD, dim=2, h=h, length=L, height=HEIGHT)
    rod = fmbd.FloatingBody("rod", mesh, density=RHO, elastic=fmbd.materials.plane_stress(E, NU))
    bodies = formulations(rod, fmbd.materials.sheet_saint_venant_kirchhoff(E, NU))
    table = fmbd.study.compare(
        lambda body: swing(body, dt, t_end),
        bodies,
        reference=swing(bodies["absolute"], dt / 4, t_end),
        names=["tip"],
        repeats=repeats,
    )
    free = {f"{m} free-free modes": rod.reduced(modes=m) for m in MODES}
    static = {f"pin's static modes, {m} more": rod.reduced(basis=fmbd.CraigBampton(("pin",), m)) for m in MODES}
    full = swing(rod, dt, t_end)
    modes = fmbd.study.compare(
        lambda body: swing(body, dt, t_end, True), free | static, reference=full, names=["tip"], repeats=1
    )
    demo.say(f"{table}\n\n{modes}")
    errors = {p.label: p.errors["tip"] for p in (*table.points, *modes.points)}
    ratios = [p.stated["tip"] / p.errors["tip"] for p in modes.points]
    falling = all(errors[a] > errors[b] for row in (list(free), list(static)) for a, b in pairwise(row))
    checks = [
        demo.Check("floating against absolute (small strain)", errors["floating"], 0.0, 3e-3),
        demo.Check("beam against floating", errors["beam, 12 modes"], errors["floating"], 3e-4),
        demo.Check("rigid is worse than 4 modes", float(errors["rigid"] > errors["reduced, 4 modes"]), 1.0, 0.0),
        demo.Check("more modes, less error", float(falling), 1.0, 0.0),
        demo.Check("16 free-free modes against floating (m)", errors["16 free-free modes"], 0.0, 3e-4),
        demo.Check("static modes and 8 against floating (m)", errors["pin's static modes, 8 more"], 0.0, 1e-5),
        demo.Check("stated over true error of reduction, smallest", min(ratios), 2.0, 1.0),
        demo.Check("stated over true error of reduction, largest", max(ratios), 2.0, 1.0),
    ]
    if args.picture:
        from fmbd_fenicsx.faces.plot import plot_curves

        points = {p.label: ([1e3 * p.seconds / p.counters["steps"]], [p.errors["tip"]]) for p in table.points}
        plot_curves(points, args.picture, ("time per step (ms)", "largest tip error (m)"), log=True)
    demo.finish(checks, full, args)


if __name__ == "__main__":
    main()
