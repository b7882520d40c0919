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
FORMS = [fmbd.Index3(), fmbd.Index2(), fmbd.GGL(), fmbd.Index1(), fmbd.Projected(fmbd.Index1()), fmbd.Baumgarte(5, 5),
         fmbd.Overdetermined(), fmbd.StateSpace()]  # fmt: skip
BASIC = FORMS[:4]
EXPECTED = {2: {3: (3, 2, 1), 2: (3, 3, 2), 1: (3, 3, 3)}, 3: {3: (5, 3, 2), 2: (5, 5, 3), 1: (5, 5, 5)}}


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
    made.sensor("x", fmbd.coordinates(body))
    return made


def constant(scheme):
    """A run with constant steps as a function of the step."""
    return lambda h: fmbd.solve(scene(), t_end=1.0, dt=h, scheme=scheme, newton=TIGHT)


def order_rows(reference, fast):
    """Rows (scheme and form, orders of q, v, lambda) and checks against the known orders."""
    rows, checks = [["scheme", "form", "q", "v", "lambda"]], []
    steps = {3: (40, 80, 160), 2: (20, 40, 80), 1: (8, 16, 32)}  # three stages: above roundoff
    cases = [(fmbd.Radau(2, f, None), steps[3]) for f in (BASIC if fast else FORMS)]
    cases += [] if fast else [(fmbd.Radau(3, f, None), steps[f.index]) for f in FORMS]
    cases += [(fmbd.BDF(k, f, None), (80, 160, 320)) for k in (2, 3) for f in (BASIC[:3] if fast else FORMS)]
    cases += [(fmbd.GeneralizedAlpha(0.8, form=f), (80, 160, 320)) for f in (fmbd.Index3(), fmbd.GGL())]
    cases += [(s, (80, 160, 320)) for s in (fmbd.Rattle(), fmbd.EnergyMomentum(), fmbd.HalfExplicit(None))]
    for scheme, steps in cases:
        table = study.orders(constant(scheme), [1.0 / n for n in steps], reference=reference, names=["q", "v", "lam"])
        found = [table.order(n) for n in ("q", "v", "lam")]
        form = getattr(scheme, "form", None)
        label = scheme.name.split(", ")[0].replace("rho_inf=0.8)", "0.8)").replace("(rho_inf=0.8", "(0.8)")
        rows.append([label, "" if form is None else form.name, *(f"{x:.2f}" for x in found)])
        if isinstance(scheme, fmbd.Radau) and scheme.stages == 2 and form in BASIC:
            short = max(e - f for e, f in zip(EXPECTED[2][form.index], found, strict=True))
            checks.append(demo.Check(f"{label}, {form.name}: orders short by", max(short, 0.0), 0.0, 0.15))
    return rows, checks


def work(reference, fast):
    """Error against work of the error-controlled schemes."""
    tolerances = [1e-3, 1e-5] if fast else [1e-3, 1e-5, 1e-7, 1e-9]
    makers = {f"Radau IIA(3), {f.name}": lambda r, f=f: fmbd.Radau(3, f, r) for f in (BASIC if fast else FORMS)}
    makers |= {f"BDF, {f.name}": lambda r, f=f: fmbd.BDF(5, f, r) for f in (BASIC if fast else FORMS)}
    makers["half-explicit (4)"] = lambda r: fmbd.HalfExplicit(r)
    made = [
        study.Configuration(n, lambda r, m=m: fmbd.solve(scene(), t_end=1.0, scheme=m(r)), tolerances)
        for n, m in makers.items()
    ]
    return study.work_precision(made, reference=reference, names=["q", "v", "lam"], repeats=1 if fast else 3)


def main():
    """Both tables."""
    args = demo.arguments(__doc__, {"--markdown": ""})
    reference = fmbd.solve(
        scene(), t_end=1.0, scheme=fmbd.Radau(3, fmbd.StateSpace(), 1e-12), newton=fmbd.Newton(max_iterations=20)
    )
    rows, checks = order_rows(reference, args.fast)
    demo.say(study.aligned(rows))
    done = work(reference, args.fast)
    demo.say(done)
    checks.append(demo.Check("failed runs", float(len(done.failures)), 0.0, 0.5))
    if args.picture:
        shown = {f"{n}, {f}" for n in ("Radau IIA(3)", "BDF") for f in ("Index3", "GGL", "StateSpace")} | {
            "half-explicit (4)"
        }
        replace(done, points=tuple(p for p in done.points if p.label in shown)).figure(args.picture)
    if args.markdown:
        Path(args.markdown).write_text(study.markdown(rows) + "\n\n" + done.markdown() + "\n")
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
