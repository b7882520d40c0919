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
BEAMDYN = np.loadtxt(Path(__file__).parent / "rod_beamdyn.csv", delimiter=",", skiprows=1)
section = fmbd.RodSection(COMPOSITE, mass=0.08538, inertia=(0.014433, 0.004097, 0.010336))
beam = fmbd.Rod("beam", [(0, 0, 0), (10, 0, 0)], section, elements=4)
scene = fmbd.Scene("composite beam")
scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
scene.add(fmbd.forces.force("load", beam.surface("end"), lambda t: (0, 0, 150.0)))
scene.sensor("tip", fmbd.sensors.position(beam.surface("end")))
scene.sensor("root", fmbd.sensors.section_forces(beam.surface("start")))

t_end = 1.0 if args.fast else 10.0
runs = [fmbd.solve(scene, t_end=t_end, dt=h, scheme=fmbd.GeneralizedAlpha(0.0)) for h in (5e-3, 2.5e-3)]
tips = [np.array([np.interp(BEAMDYN[:, 0], r.times, x) for x in r["tip"].T]).T for r in runs]
seen = BEAMDYN[:, 0] <= t_end + 1e-9
given = BEAMDYN[seen][:, [3, 2, 1]] + (10, 0, 0)
off = np.sqrt(np.mean((tips[0][seen] - given) ** 2, axis=0))
halved = np.sqrt(np.mean((tips[0] - tips[1])[seen] ** 2, axis=0))
checks = [
    demo.Check(f"composite beam, tip {x}: rms from BeamDyn over that by halving h, 1", a / b, 0.0, 1.0)
    for x, a, b in zip("xyz", off, halved, strict=True)
]

# order in the step: a smooth load
h, smooth = 4e-3, fmbd.Scene("smooth load")
smooth.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
smooth.add(fmbd.forces.force("load", beam.surface("end"), lambda t: (0, 0, 150.0 * np.sin(5 * t) ** 4)))
smooth.sensor("place", fmbd.sensors.position(beam.surface("end")))
smooth.sensor("velocity", fmbd.sensors.velocity(beam.surface("end")))
smooth.sensor("section forces", fmbd.sensors.section_forces(beam.surface("start")))
finer = [fmbd.solve(smooth, t_end=0.32, dt=k, scheme=fmbd.GeneralizedAlpha(0.8)) for k in (h, h / 2, h / 4)]
for name in smooth.sensors:
    x = [r[name][-1] for r in finer]
    order = np.log2(np.linalg.norm(x[0] - x[1]) / np.linalg.norm(x[1] - x[2]))
    checks.append(demo.Check(f"order of the {name} in h", float(order), 2.0, 0.25))


def ramp(t):
    """N m: up to 200 at 2.5 s and down to 0 at 5 s."""
    return max(80.0 * min(t, 5.0 - t), 0.0)


free = fmbd.Rod(
    "free",
    [(6, 0, 0), (0, 8, 0)],
    fmbd.RodSection((1e4, 1e4, 1e4, 500, 500, 500), 1.0, (20, 10, 10)),
    elements=3,
    degree=2,
)
flight = fmbd.Scene("free flight", breakpoints=(2.5, 5.0))
flight.add(free, fmbd.forces.force("F", free.surface("start"), lambda t: (ramp(t) / 10, 0, 0)))
flight.add(fmbd.forces.torque("M", free.surface("start"), lambda t: (0, ramp(t), ramp(t) / 2)))
run = fmbd.solve(
    flight, t_end=6.0 if args.fast else 8.0, dt=0.1, scheme=fmbd.EnergyMomentum(), newton=fmbd.Newton(tolerance=1e-12),
    output=fmbd.Output(snapshots=9),
)  # fmt: skip
after, total = run.times > 5.0 + 1e-9, run.total_energy
checks.append(demo.Check("free flight: energy after the loads, 1", np.ptp(total[after]) / total[-1], 0.0, 1e-9))
last = [s for s in run.snapshots if s.t > 5.0]
for name, k in (("momentum", 0), ("angular momentum", 1)):
    p = np.array([run.momenta(s)[k] for s in last])
    checks.append(demo.Check(f"free flight: {name}, 1", np.abs(p - p[-1]).max() / np.linalg.norm(p[-1]), 0.0, 1e-10))
impulse = np.array([50.0, 0.0, 0.0])
checks.append(
    demo.Check(
        "free flight: momentum against the impulse, 1", np.linalg.norm(run.momenta()[0] - impulse) / 50, 0.0, 1e-2
    )
)

if args.picture:
    shapes = [(s.t, (free, run.system.frame_poses(s.q))) for s in run.snapshots]
    before, later = ([shape for t, shape in shapes if (t > 5.0) == late] for late in (False, True))
    panels(args.picture, {"free flight, 0 to 5 s": before, "after the loads": later}, args.title)
if args.animate:
    flown = fmbd.solve(flight, t_end=6.0, dt=0.1, scheme=fmbd.EnergyMomentum(), output=demo.snapshots(args))
    demo.film(flown, args)
demo.finish(checks, run, args)
