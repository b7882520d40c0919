"""Stiff spring pendulum: a mass on a spring of stiffness 1 / eps^2 that turns into a rigid rod as eps goes to zero.

Run:  ./with-dolfinx python3 demos/stiff_pendulum.py     (--fast: four values of eps, --picture FILE: errors over eps)

U = (r - 1)^2 / (2 eps^2), m = g = 1, started on the slow manifold r = 1 + eps^2 (r omega^2 + g cos theta), where nothing
vibrates. A step h >> eps sees an index-3 problem: position errors must not depend on eps (Hairer and Wanner, Solving ODEs
II, section VII.5). They stay below twice those at eps = 0.1, for three stages of Radau below three times: there eps = 0.1 is
resolved and shows order 5, while eps = 0.01 (h omega = 5) is neither resolved nor stiff.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot

T_END, H, THETA = 2.0, 0.05, 1.0
TIGHT = fmbd.Newton(tolerance=1e-10, max_iterations=40)
SCHEMES = {  # and the largest position error allowed, over that at eps = 0.1
    "generalized-alpha(0.8)": (fmbd.GeneralizedAlpha(0.8), 2.0),
    "generalized-alpha(0)": (fmbd.GeneralizedAlpha(0.0), 2.0),
    "BDF2": (fmbd.BDF(2, fmbd.Index3(), rtol=None), 2.0),
    "Radau IIA(2)": (fmbd.Radau(2, rtol=None), 2.0),
    "Radau IIA(3)": (fmbd.Radau(3, rtol=None), 3.0),
}


def slow_start(eps):
    """Position and velocity on the slow manifold at rest in theta: r solves its equation, r' follows from its derivative."""
    r, rate, omega = 1.0, 0.0, 0.0
    for _ in range(60):
        push = -(2 * rate * omega + np.sin(THETA)) / r  # theta''
        r = 1 + eps**2 * (r * omega**2 + np.cos(THETA))
        rate = eps**2 * (rate * omega**2 + 2 * r * omega * push - np.sin(THETA) * omega)
    return r * np.array([np.sin(THETA), -np.cos(THETA)]), rate * np.array([np.sin(THETA), -np.cos(THETA)])


def scene(eps, start=None):
    """The mass in Cartesian coordinates."""

    def force(q, v, t):
        r = np.sqrt(q[0] ** 2 + q[1] ** 2)
        pull = -(r - 1) / (eps**2 * r)
        return np.array([pull * q[0], pull * q[1] - 1.0])

    made = fmbd.Scene("stiff pendulum")
    start = slow_start(eps) if start is None else start
    made.add(fmbd.CoordinateBody("mass", np.eye(2), force, *start, vectorized=True))
    made.sensor("x", fmbd.coordinates("mass"))
    made.sensor("v", fmbd.coordinates("mass", level=1))
    return made


def reference(eps, scheme=SCHEMES["Radau IIA(3)"][0], h=0.1 * H):
    """End position and velocity, (2, 2); the reference has a tenth of the step."""
    run = fmbd.solve(scene(eps), t_end=T_END, dt=h, scheme=scheme, newton=TIGHT)
    return np.array([run["x"][-1], run["v"][-1]])


def errors(scheme, eps, h, exact):
    """Errors of position and velocity at the end."""
    return np.abs(reference(eps, scheme, h) - exact).max(axis=1)


if __name__ == "__main__":
    args = demo.arguments(__doc__)
    stiffness = [1e-1, 1e-2, 1e-3, 1e-6] if args.fast else [10.0**-k for k in range(1, 7)]
    exact = {eps: reference(eps) for eps in stiffness}
    found = {n: np.array([errors(s, e, H, exact[e]) for e in stiffness]) for n, (s, _) in SCHEMES.items()}
    rows = [["errors of position / velocity", *(f"eps = {e:.0e}" for e in stiffness)]]
    demo.say(fmbd.study.aligned(rows + [[n, *(f"{x:.1e} / {v:.1e}" for x, v in found[n])] for n in found]))
    name = "{}: largest position error over that at eps = 0.1"
    checks = [demo.Check(name.format(n), max(x[:, 0]) / x[0, 0], 0.0, SCHEMES[n][1]) for n, x in found.items()]
    if args.picture:
        with plot.figure(args.picture, title=args.title) as axes:
            for name, error in found.items():
                axes.loglog(stiffness, error[:, 0], "o-", label=name)
            axes.set(xlabel="eps (h = 0.05 s for all)", ylabel=f"position error at t = {T_END:g} s (m)")
            axes.invert_xaxis()
    demo.finish(checks, None, args)
