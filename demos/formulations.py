"""Formulations: one elastic pendulum as rigid body, beam, reduced, floating and absolute body; error against run time.

Run:  ./with-dolfinx python3 demos/formulations.py            (--fast: coarse; --picture formulations.png)

The scene is the same for all: a rod on a pin under gravity. Reference: the absolute body, nonlinear, with steps a quarter as
long. The first table answers whether a linear floating frame is enough. The second has the floating body as its reference, in the
same frame and with the same steps, so that only the choice of modes counts: the error falls with every mode, slowly with
free-free modes, fast once the static modes of the pin carry what the joint does to the rod (Craig-Bampton). Each of these runs
states the error of its modes itself, from a run with more of them, without the field.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

E, NU, RHO, L, HEIGHT, DT = 2e7, 0.3, 1000.0, 1.0, 0.1, 2e-3  # Pa, -, kg/m^3, m, m, s
MODES = (2, 4, 8, 16, 32)


def swing(body, dt=DT, states_error=False):
    """The pendulum's run; not a line of it knows the formulation."""
    pin, tip = ("start", "end") if isinstance(body, fmbd.Beam) else ("pin", "tip")
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface(pin)))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    output = fmbd.Output(energy=False, estimate_reduction=states_error)
    return fmbd.solve(scene, t_end=t_end, dt=dt, output=output)


args = demo.arguments(__doc__)
h, t_end, repeats = (0.1, 0.25, 1) if args.fast else (0.05, 1.0, 3)
mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=h, length=L, height=HEIGHT)
rod = fmbd.FloatingBody("rod", mesh, density=RHO, elastic=fmbd.materials.plane_stress(E, NU))
section = fmbd.Section.rectangle(youngs_modulus=E, poisson_ratio=NU, density=RHO, width=1.0, height=HEIGHT)
absolute = fmbd.AbsoluteBody("rod", mesh, density=RHO, energy=fmbd.materials.sheet_saint_venant_kirchhoff(E, NU))
bodies = {
    "rigid": rod.reduced(modes=0),
    "beam, 12 modes": fmbd.Beam("rod", (0.0, 0.0), (L, 0.0), section, attached=False, modes=12),
    **{f"reduced, {m} modes": rod.reduced(modes=m) for m in (4, 8, 16, 32)},
    "floating": rod,
    "absolute": absolute,
}
table = fmbd.study.compare(swing, bodies, reference=swing(absolute, DT / 4), names=["tip"], repeats=repeats)
bases = {  # of the field that the floating body has
    "free-free modes": {m: rod.reduced(modes=m) for m in MODES},
    "modes beside the pin's static ones": {m: rod.reduced(basis=fmbd.CraigBampton(("pin",), m)) for m in MODES},
}
full, stating = swing(rod), lambda body: swing(body, states_error=True)
few = {f"{m} {name}": body for name, row in bases.items() for m, body in row.items()}
modes = fmbd.study.compare(stating, few, reference=full, names=["tip"], repeats=1)
demo.say(f"{table}\n\n{modes}")

errors = {p.label: p.errors["tip"] for p in table.points}
free, static = true = np.reshape([p.errors["tip"] for p in modes.points], (2, -1))
stated = np.reshape([p.stated["tip"] for p in modes.points], (2, -1))
checks = [
    Check("floating against absolute (small strain)", errors["floating"], 0.0, 3e-3),
    Check("beam against floating", errors["beam, 12 modes"], errors["floating"], 3e-4),
    Check.at_least("rigid is worse than 4 modes by a factor of", errors["rigid"] / errors["reduced, 4 modes"], 1.0),
    Check.at_least("more modes, less error, at each step by a factor of", (true[:, :-1] / true[:, 1:]).min(), 1.0),
    Check("16 free-free modes against floating (m)", free[MODES.index(16)], 0.0, 3e-4),
    Check("static modes and 8 against floating (m)", static[MODES.index(8)], 0.0, 1e-5),
    Check("stated over true error of reduction, smallest", (stated / true).min(), 2.0, 1.0),
    Check("stated over true error of reduction, largest", (stated / true).max(), 2.0, 1.0),
]
if args.picture:
    with plot.figure(args.picture, 1, 2, title=args.title) as (left, right):
        for p, mark in zip(table.points, "osv^<>DP", strict=True):
            left.loglog(1e3 * p.seconds / p.counters["steps"], p.errors["tip"], mark, label=p.label)
        left.set(xlabel="time of a step (ms)", ylabel="tip error against the absolute body (m)")
        for k, name in enumerate(bases):
            right.loglog(MODES, true[k], f"C{k}o-", label=name)
            right.loglog(MODES, stated[k], f"C{k}x:", label="stated by the runs")
        right.set(xlabel="modes", ylabel="tip error against the full field (m)", xticks=MODES, xticklabels=MODES)
        right.minorticks_off()
demo.finish(checks, full, args)
