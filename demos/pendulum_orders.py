"""Orders of the elastic pendulum in the step and in the mesh size, and its error against time.

Run:  ./with-dolfinx python3 demos/pendulum_orders.py            (--fast: the step only; --dim 3; --picture FILE: the orders)

The scene of ``elastic_pendulum.py``, its gravity switched on smoothly: loads must be smooth before an order means anything.
"""

from functools import partial

from elastic_pendulum import build

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot, study
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__, {"--dim": (2, 3)})
NAMES, QUIET = ["tip", "tip velocity", "pin force"], fmbd.Output(energy=False)
scene = build(args.dim, 0.2, ramp=0.2)


def in_step(rho_inf, h):
    """A run with steps h."""
    return fmbd.solve(scene, t_end=0.5, dt=h, scheme=fmbd.GeneralizedAlpha(rho_inf), output=QUIET)


def in_mesh(degree, size):
    """A run with cells of a size."""
    return fmbd.solve(build(args.dim, size, degree, ramp=0.2), t_end=0.4, dt=4e-3, output=QUIET)


steps = [8e-3, 4e-3, 2e-3] if args.fast else [8e-3, 4e-3, 2e-3, 1e-3]
reference = in_step(0.8, steps[-1] / 4)
tables = {"step (s)": study.orders(partial(in_step, 0.8), steps, reference=reference, names=NAMES)}
if not args.fast:
    sizes = [0.1, 0.05, 0.025, 0.0125] if args.dim == 2 else [0.2, 0.1, 0.05]
    fine = in_mesh(2, sizes[-1] / 2)
    for p in (1, 2):
        made = study.orders(partial(in_mesh, p), sizes, reference=fine, names=NAMES, parameter="mesh size")
        tables[f"mesh size, P{p} (m)"] = made
    runs = [study.Configuration(f"rho_inf {r}", partial(in_step, r), steps[:3]) for r in (0.9, 0.5, 0.0)]
    demo.say(f"error against time\n{study.work_precision(runs, reference=reference, names=NAMES)}\n")
for name, table in tables.items():
    demo.say(f"{name}\n{table}\n")
orders = {n: tables["step (s)"].order(n) for n in NAMES}
checks = [Check(f"order of {n} in the step", order, 2.0, 0.15) for n, order in orders.items()]
if args.picture:
    with plot.figure(args.picture, 1, len(tables), title=args.title) as panels:
        for axes, (name, table) in zip([panels] if len(tables) == 1 else panels, tables.items(), strict=True):
            for n, unit in zip(NAMES, ("m", "m/s", "N"), strict=True):
                axes.loglog(table.values, table.errors[n], "o-", label=f"{n} ({unit}): order {table.order(n):.2f}")
            axes.set(xlabel=name, ylabel="largest error")
demo.finish(checks, None, args)
