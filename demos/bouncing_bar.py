"""An elastic bar falls on the ground, again and again: periodic motion with an exact solution.

Run:  ./with-dolfinx python3 demos/bouncing_bar.py [--animate FILE]     (also with mpirun -n 2)

A bar of length L drops from h0. It stays on the ground for 2 L / c, leaves with waves in it, comes back when they
have turned its motion around, and reaches h0 at rest and unstressed: period 16/3 s. The force is
rho c (v + g (t - 1)) in the first contact (300 to 500 N), mirrored in the second. Doyen, Ern, Piperno, doi:10.1137/100791440.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__, {"--cells": 0, "--periods": 0})
n, courant = (args.cells or 60, 1.0) if args.fast else (args.cells or 40, 0.5)
periods = args.periods or (1 if args.fast else 10)
L, E, rho, g, h0 = 10.0, 900.0, 1.0, 10.0, 5.0
c, period, CONTACTS = np.sqrt(E / rho), 16.0 / 3.0, (1.0, 5 / 3, 11 / 3, 13 / 3)  # s: touches and leaves, twice
PLACES = {0.5: 3.75, 1.8: 0.5333333333, 2.0: 1.6666666667, 2.6666666667: 3.8888888889, 3.0: 4.4444444444, 3.5: 0.6944444444,
          4.8: 3.5777777778, 5.0: 4.4444444444}  # fmt: skip

mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, L), counts=(1, n), origin=(0.0, h0), quads=True)
bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=rho, elastic=fmbd.materials.linear_elastic(E, 0.0))
ground = fmbd.contact("floor", bar.surface("bottom"), fmbd.Obstacle("ground", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0))))
scene = fmbd.Scene("bouncing bar", gravity=(0.0, -g))
scene.add(bar, ground)
scene.sensor("force", fmbd.contact_force(ground))
scene.sensor("bottom", fmbd.position(bar.surface("bottom")))
dt = period / (2 * np.ceil(period / (courant * L / n / c) / 2))
run = fmbd.solve(scene, t_end=periods * period, dt=dt, output=demo.snapshots(args))


def law(t):
    """Exact force at a time or times of the first period."""
    inside = (t > CONTACTS[0]) & (t < CONTACTS[1]) | (t > CONTACTS[2]) & (t < CONTACTS[3])
    return inside * (300 + rho * c * g * np.where(t < 3, t - 1, 13 / 3 - t))


def off(values, start, end):
    """Relative RMS error of the force in a time span."""
    inside = (t > start) & (t < end)
    return np.sqrt(np.mean((values[inside] / law(t[inside]) - 1) ** 2))


t, force, energy = run.times[1:] - dt / 2, run["force"][1:, 1], run.total_energy  # forces act in the middle of a step
on = np.flatnonzero((force > 1.0) & (t < period))
flight = np.flatnonzero(np.diff(on) > 10)[0]
seen = t[on[[0, flight, flight + 1, -1]]]
width = max(1, int(0.05 / dt))
mean = np.convolve(force, np.ones(width) / width, "same")  # without the ringing of dispersed waves
bottom = np.interp(list(PLACES), run.times, run["bottom"][:, 1])
late = (2 * dt, 3 * dt, 3 * dt, 0.02 + 2 * dt)  # waves disperse on their way: the second release comes a little late
names = ("first contact", "first release", "second contact", "second release")
checks = [Check(f"{name}, s", *figures) for name, *figures in zip(names, seen, CONTACTS, late, strict=True)] + [
    Check("force law of the first contact, RMS relative", off(force, 1.1, 1.6), 0.0, 0.01),
    Check("force law of the second contact, RMS relative", off(force, 3.75, 4.25), 0.0, 0.12),
    Check("the same, mean over 0.05 s", off(mean, 3.75, 4.25), 0.0, 0.04),
    Check("bottom displacement, largest error over h0", np.abs(bottom - list(PLACES.values())).max() / h0, 0.0, 0.05),
    Check("largest energy gain, relative", energy.max() / energy[0] - 1, 0.0, 1e-8),
    Check("energy left after all periods", energy[-1] / energy[0], 1.0, 0.1),
]
if args.picture:
    known = {"force y": lambda t: law(t % period), "bottom y": (list(PLACES), list(PLACES.values()))}
    run.plot("force y", "bottom y", file=args.picture, reference=known)
demo.film(run, args, ["bottom y", "force y"])
demo.finish(checks, run, args)
