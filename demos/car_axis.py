"""Car axis: a light axle on two very stiff wheel springs drives over a bumpy road; an index-3 test problem of the IVP set.

Run:  ./with-dolfinx python3 demos/car_axis.py          (--fast: looser tolerance; --picture FILE, --animate FILE)

Two points (x_l, y_l), (x_r, y_r) at the ends of the axle, springs of stiffness 1 / eps^2 (against the masses) to the wheels,
the right wheel at (x_b(t), y_b(t)). Constraints: the axle has length L and the left end moves perpendicular to the road chord.
Source: Mazzia and Magherini, Test Set for IVP Solvers, problem "caraxis"; reference at t = 3 s from there and an own run.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check

L, L0, EPS, M, R, OMEGA, G = 1.0, 0.5, 0.01, 10.0, 0.1, 10.0, 1.0
K = 0.5 * M * EPS**2
REFERENCE = np.array([0.049345578427524094, 0.496989460230008, 1.0417425248854235, 0.37391102726534786])
REFERENCE_RATE = np.array([-0.07705836840359158, 0.007446866592073264, 0.017556815753417734, 0.7703410437784894])


def road(t):
    """The right wheel."""
    y = R * np.sin(OMEGA * t)
    return np.sqrt(L**2 - y**2), y


def force(q, v, t):
    """Springs and weight, (4,)."""
    xl, yl, xr, yr = q
    xb, yb = road(t)
    left, right = np.sqrt(xl**2 + yl**2), np.sqrt((xr - xb) ** 2 + (yr - yb) ** 2)
    pull_left, pull_right = (L0 - left) / left, (L0 - right) / right
    return np.array([pull_left * xl, pull_left * yl - K * G, pull_right * (xr - xb), pull_right * (yr - yb) - K * G])


def constraint(q, t):
    """g, (2,)."""
    xl, yl, xr, yr = q
    xb, yb = road(t)
    return np.array([xl * xb + yl * yb, (xl - xr) ** 2 + (yl - yr) ** 2 - L**2])


def outline(q):
    """The axle and its springs down to the road's height, for pictures."""
    left, right = q[:2], q[2:]
    return [np.array([left, right]), np.array([(0.0, 0.0), left]), np.array([(1.0, 0.0), right])]


def scene():
    """The axle at the start, at rest but for a drift to the left."""
    made = fmbd.Scene("car axis")
    start, rate = [0.0, 0.5, 1.0, 0.5], [-0.5, 0.0, -0.5, 0.0]
    given = {"constraint": constraint, "vectorized": True, "outline": outline}
    made.add(fmbd.CoordinateBody("axle", K * np.eye(4), force, start, rate, **given))
    made.sensor("ends", fmbd.coordinates("axle", unit="m", names=("x_l", "y_l", "x_r", "y_r")))
    made.sensor("rates", fmbd.coordinates("axle", level=1, unit="m/s"))
    return made


if __name__ == "__main__":
    args = demo.arguments(__doc__)
    scheme = fmbd.Radau(rtol=1e-5 if args.fast else 1e-7)
    run = fmbd.solve(scene(), t_end=3.0, scheme=scheme, output=demo.snapshots(args))
    share = 1.0 if args.fast else 1e-2
    checks = [
        Check("largest error of positions (m)", np.abs(run["ends"][-1] - REFERENCE).max(), 0.0, 1e-6 * share),
        Check("largest error of rates (m/s)", np.abs(run["rates"][-1] - REFERENCE_RATE).max(), 0.0, 1e-4 * share),
    ]
    demo.show(run, args, ["ends"], reference={"ends": (3.0, REFERENCE)}, view=fmbd.View(instants=4))
    demo.finish(checks, run, args)
