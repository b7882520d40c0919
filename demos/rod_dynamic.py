"""Rods in motion: a composite beam under a sudden load, free flight with all invariants kept, order in the step.

Run:  ./with-dolfinx python3 demos/rod_dynamic.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

Composite beam of 10 m, all section forces coupled, 150 (lb) at its tip from t = 0: Wang et al., doi:10.1002/we.2101, values by
BeamDyn with rho_inf = 0 and h = 5 ms. Free rod: Simo and Vu-Quoc, doi:10.1016/0045-7825(88)90073-4, loads until 5 s.
"""

from pathlib import Path

import numpy as np
from rod_model import panels
from rod_references import COMPOSITE

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post import demo

args = demo.arguments(__doc__)


def cantilever(load):
    """The composite beam, a force load(t) along z at its tip."""
    section = fmbd.RodSection(COMPOSITE, mass=0.08538, inertia=(0.014433, 0.004097, 0.010336))
    beam = fmbd.Rod("beam", [(0, 0, 0), (10, 0, 0)], section, elements=4)
    scene = fmbd.Scene("composite beam")
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.forces.force("load", beam.surface("end"), lambda t: (0, 0, load(t))))
    scene.sensor("place", fmbd.sensors.position(beam.surface("end")))
    scene.sensor("velocity", fmbd.sensors.velocity(beam.surface("end")))
    scene.sensor("section forces", fmbd.sensors.section_forces(beam.surface("start")))
    return scene


# the tip of BeamDyn, in its axes, and ours with h and half of it
given = np.loadtxt(Path(__file__).parent / "rod_beamdyn.csv", delimiter=",", skiprows=1)
t_end = 1.0 if args.fast else 10.0
given = given[given[:, 0] <= t_end + 1e-9]
sudden = cantilever(lambda t: 150.0)
runs = [fmbd.solve(sudden, t_end=t_end, dt=h, scheme=fmbd.GeneralizedAlpha(0.0)) for h in (5e-3, 2.5e-3)]
tips = [np.array([np.interp(given[:, 0], r.times, x) for x in r["place"].T]).T for r in runs]
off, halved = (np.sqrt(np.mean((tips[0] - x) ** 2, axis=0)) for x in (given[:, [3, 2, 1]] + (10, 0, 0), tips[1]))
checks = [
    demo.Check(f"composite beam, tip {x}: rms from BeamDyn over that by halving h, 1", a / b, 0.0, 1.0)
    for x, a, b in zip("xyz", off, halved, strict=True)
]

# order in the step: a smooth load
smooth = cantilever(lambda t: 150.0 * np.sin(5 * t) ** 4)
finer = [fmbd.solve(smooth, t_end=0.32, dt=h, scheme=fmbd.GeneralizedAlpha(0.8)) for h in (4e-3, 2e-3, 1e-3)]
for name in smooth.sensors:
    x = [r[name][-1] for r in finer]
    order = np.log2(np.linalg.norm(x[0] - x[1]) / np.linalg.norm(x[1] - x[2]))
    checks.append(demo.Check(f"order of the {name} in h", float(order), 2.0, 0.25))


def ramp(t):
    """N m: up to 200 at 2.5 s and down to 0 at 5 s."""
    return max(80.0 * min(t, 5.0 - t), 0.0)


stiffness = (1e4, 1e4, 1e4, 500, 500, 500)
section = fmbd.RodSection(stiffness, mass=1.0, inertia=(20, 10, 10))
free = fmbd.Rod("free", [(6, 0, 0), (0, 8, 0)], section, elements=3, degree=2)
flight = fmbd.Scene("free flight", breakpoints=(2.5, 5.0))
flight.add(free, fmbd.forces.force("F", free.surface("start"), lambda t: (ramp(t) / 10, 0, 0)))
flight.add(fmbd.forces.torque("M", free.surface("start"), lambda t: (0, ramp(t), ramp(t) / 2)))
run = fmbd.solve(
    flight, t_end=6.0 if args.fast else 8.0, dt=0.1, scheme=fmbd.EnergyMomentum(), newton=fmbd.Newton(tolerance=1e-12),
    output=fmbd.Output(snapshots=9),
)  # fmt: skip

# after the loads nothing changes
total = run.total_energy[run.times > 5.0 + 1e-9]
checks.append(demo.Check("free flight: energy after the loads, 1", np.ptp(total) / total[-1], 0.0, 1e-9))
late = [run.momenta(s) for s in run.snapshots if s.t > 5.0]
for name, p in zip(("momentum", "angular momentum"), np.moveaxis(np.array(late), 1, 0), strict=True):
    checks.append(demo.Check(f"free flight: {name}, 1", np.abs(p - p[-1]).max() / np.linalg.norm(p[-1]), 0.0, 1e-10))
missed = np.linalg.norm(run.momenta()[0] - (50.0, 0.0, 0.0)) / 50.0
checks.append(demo.Check("free flight: momentum against the impulse, 1", missed, 0.0, 1e-2))

if args.picture:
    shapes = [(s.t, (free, run.system.frame_poses(s.q))) for s in run.snapshots]
    before, later = ([shape for t, shape in shapes if (t > 5.0) == past] for past in (False, True))
    panels(args.picture, {"free flight, 0 to 5 s": before, "after the loads": later}, args.title)
if args.animate:
    demo.film(fmbd.solve(flight, t_end=6.0, dt=0.1, scheme=fmbd.EnergyMomentum(), output=demo.snapshots(args)), args)
demo.finish(checks, run, args)
