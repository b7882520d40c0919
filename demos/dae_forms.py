"""One pendulum, all DAE forms and time integrators: observed orders, and error against work.

Run:  ./with-dolfinx python3 demos/dae_forms.py     (--fast: fewer schemes, --markdown FILE: the tables of docs/dae_forms.md)

A point mass in Cartesian coordinates on a rod, from angle 1 with rate 1, over 1 s; the reference is an error-controlled run in
the tangent space, rtol = 1e-12. Orders are those of position, velocity and multiplier at the end.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, study

TIGHT = fmbd.Newton(tolerance=1e-11, max_iterations=30)
BASIC = [fmbd.Index3(), fmbd.Index2(), fmbd.GGL(), fmbd.Index1()]
ALL = [*BASIC, fmbd.Projected(fmbd.Index1()), fmbd.Baumgarte(5, 5), fmbd.Overdetermined(), fmbd.StateSpace()]
EXPECTED = {3: (3, 2, 1), 2: (3, 3, 2), 1: (3, 3, 3)}  # of q, v, lambda by Radau IIA(2), by the index
SHOWN = {f"{n}, {f}" for n in ("Radau IIA(3)", "BDF") for f in ("Index3", "GGL", "StateSpace")} | {"half-explicit (4)"}


def scene():
    """The pendulum."""
    made = fmbd.Scene("pendulum")
    body = fmbd.CoordinateBody(
        "mass", np.eye(2), lambda q, v, t: np.array([0 * q[0], 0 * q[1] - 9.81]),
        [np.sin(1), -np.cos(1)], [np.cos(1), np.sin(1)],
        constraint=lambda q, t: np.array([0.5 * (q[0] ** 2 + q[1] ** 2 - 1)]),
        jacobian=lambda q, t: q[None], gamma=lambda q, v, t: np.array([v[0] ** 2 + v[1] ** 2]), vectorized=True,
    )  # fmt: skip
    made.add(body)
    return made


args = demo.arguments(__doc__, {"--markdown": ""})
forms, quantities = (BASIC if args.fast else ALL), ["q", "v", "lam"]
exact = fmbd.Radau(3, fmbd.StateSpace(), 1e-12)
reference = fmbd.solve(scene(), t_end=1.0, scheme=exact, newton=fmbd.Newton(max_iterations=20))

# three stages: above roundoff
short, usual = {3: (40, 80, 160), 2: (20, 40, 80), 1: (8, 16, 32)}, (20, 40) if args.fast else (80, 160, 320)
cases = [(fmbd.Radau(2, f, None), short[3]) for f in forms]
cases += [] if args.fast else [(fmbd.Radau(3, f, None), short[f.index]) for f in forms]
cases += [
    (fmbd.BDF(k, f, None), usual) for k in ((2,) if args.fast else (2, 3)) for f in (BASIC[:3] if args.fast else ALL)
]
cases += [(fmbd.GeneralizedAlpha(0.8, form=f), usual) for f in (fmbd.Index3(), fmbd.GGL())]
cases += [(s, usual) for s in (fmbd.Rattle(), fmbd.EnergyMomentum(), fmbd.HalfExplicit(None))]
rows, checks = [["scheme", "form", "q", "v", "lambda"]], []
for scheme, steps in cases:
    solved = lambda h, s=scheme: fmbd.solve(scene(), t_end=1.0, dt=h, scheme=s, newton=TIGHT)
    table = study.orders(solved, [1.0 / n for n in steps], reference=reference, names=quantities)
    found, form = [table.order(n) for n in quantities], getattr(scheme, "form", None)
    label = scheme.name.split(", ")[0].replace("rho_inf=0.8)", "0.8)").replace("(rho_inf=0.8", "(0.8)")
    rows.append([label, "" if form is None else form.name, *(f"{x:.2f}" for x in found)])
    if isinstance(scheme, fmbd.Radau) and scheme.stages == 2 and form in BASIC:
        lost = max(e - f for e, f in zip(EXPECTED[form.index], found, strict=True))
        checks.append(demo.Check(f"{label}, {form.name}: orders short by", max(lost, 0.0), 0.0, 0.15))
demo.say(study.aligned(rows))

makers = {f"Radau IIA(3), {f.name}": lambda r, f=f: fmbd.Radau(3, f, r) for f in forms}
makers |= {f"BDF, {f.name}": lambda r, f=f: fmbd.BDF(5, f, r) for f in forms} | {"half-explicit (4)": fmbd.HalfExplicit}
runs = {n: lambda r, m=m: fmbd.solve(scene(), t_end=1.0, scheme=m(r)) for n, m in makers.items()}
tolerances = [1e-3] if args.fast else [1e-3, 1e-5, 1e-7, 1e-9]
lines = [study.Configuration(name, run, tolerances) for name, run in runs.items()]
done = study.work_precision(lines, reference=reference, names=quantities, repeats=1 if args.fast else 3)
demo.say(done)
checks.append(demo.Check("failed runs", len(done.failures), 0.0, 0.5))
if args.picture:
    replace(done, points=tuple(p for p in done.points if p.label in SHOWN)).figure(args.picture, title=args.title)
if args.markdown:
    Path(args.markdown).write_text(study.markdown(rows) + "\n\n" + done.markdown() + "\n")
demo.finish(checks, None, args)
