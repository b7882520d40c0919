"""An elastic bar falls on the ground, again and again: periodic motion with an exact solution.

Run:  ./with-dolfinx python3 demos/bouncing_bar.py          (also: ./with-dolfinx mpirun -n 2 python3 demos/bouncing_bar.py)

A bar of length L drops from h0. It stays on the ground for 2 L / c, leaves with waves in it, comes back when they
have turned its motion around, and reaches h0 at rest and unstressed: period 16/3 s. The force is
rho c (v + g (t - 1)) in the first contact (300 to 500 N), mirrored in the second. Doyen, Ern, Piperno, doi:10.1137/100791440.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.faces.demo import Check

args = demo.arguments(__doc__, {"--cells": 0, "--periods": 0})
n = args.cells or (60 if args.fast else 40)
courant = 1.0 if args.fast else 0.5
periods = args.periods or (1 if args.fast else 10)
L, E, rho, g, h0, width = 10.0, 900.0, 1.0, 10.0, 5.0, 1.0
c, period = np.sqrt(E / rho), 16.0 / 3.0

mesh = fmbd.read_gmsh("meshes/block.py", size=(width, L), counts=(1, n), origin=(0.0, h0), quads=True)
bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=rho, elastic=fmbd.materials.linear_elastic(E, 0.0))
ground = fmbd.contact("floor", bar.surface("bottom"), fmbd.Obstacle("ground", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0))))
scene = fmbd.Scene("bouncing bar", gravity=(0.0, -g))
scene.add(bar, ground)
scene.sensor("force", fmbd.contact_force(ground))
scene.sensor("bottom", fmbd.position(bar.surface("bottom")))
scene.sensor("work", fmbd.contact_work())

steps = 2 * int(np.ceil(period / (courant * L / n / c) / 2))
dt = period / steps
run = fmbd.solve(scene, t_end=periods * period, dt=dt)
fmbd.say(run.report())

t, force = run.times[1:] - dt / 2, run["force"][1:, 1]
first = t < period
on = np.flatnonzero((force > 1.0) & first)
jump = on[np.flatnonzero(np.diff(on) > 10)[0] : np.flatnonzero(np.diff(on) > 10)[0] + 2]
touch, leave, again, off = t[on[0]], t[jump[0]], t[jump[1]], t[on[-1]]


def law(s: np.ndarray) -> np.ndarray:
    """Exact force in the two contacts."""
    return np.where(s < 3, 300 + rho * c * g * (s - 1), 300 + rho * c * g * (13 / 3 - s))


def law_error(start: float, end: float) -> float:
    """Relative RMS error of the force in a time span."""
    inside = (t > start) & (t < end)
    return float(np.sqrt(np.mean((force[inside] / law(t[inside]) - 1) ** 2)))


def mean_error(start: float, end: float) -> float:
    """The same for the mean over 0.05 s, without the ringing of dispersed waves."""
    inside, width = (t > start) & (t < end), max(1, int(0.05 / dt))
    mean = np.convolve(force, np.ones(width) / width, "same")
    return float(np.sqrt(np.mean((mean[inside] / law(t[inside]) - 1) ** 2)))


exact = {0.5: 3.75, 1.8: 0.5333333333, 2.0: 1.6666666667, 2.6666666667: 3.8888888889, 3.0: 4.4444444444, 3.5: 0.6944444444,
         4.8: 3.5777777778, 5.0: 4.4444444444}  # fmt: skip
bottom = np.interp(list(exact), run.times, run["bottom"][:, 1])
energy = sum(run.energy.values())
late = 0.02 + 2 * dt  # waves disperse on their way: the second release comes a little late
checks = [
    Check("first contact, s", float(touch), 1.0, 2 * dt),
    Check("first release, s", float(leave), 5 / 3, 3 * dt),
    Check("second contact, s", float(again), 11 / 3, 3 * dt),
    Check("second release, s", float(off), 13 / 3, late),
    Check("force law of the first contact, RMS relative", law_error(1.1, 1.6), 0.0, 0.01),
    Check("force law of the second contact, RMS relative", law_error(3.75, 4.25), 0.0, 0.12),
    Check("the same, mean over 0.05 s", mean_error(3.75, 4.25), 0.0, 0.04),
    Check(
        "bottom displacement, largest error over h0",
        float(np.abs(bottom - list(exact.values())).max() / h0),
        0.0,
        0.05,
    ),
    Check("largest energy gain, relative", float(energy.max() / energy[0] - 1), 0.0, 1e-8),
    Check("energy left after all periods", float(energy[-1] / energy[0]), 1.0, 0.1),
]
if args.picture:
    run.plot("force", "bottom", file=args.picture)
demo.finish(checks, run, args)
