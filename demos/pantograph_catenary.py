"""Pantograph under a catenary at 250 and 300 km/h: the reference model of EN 50318:2002.

Run:  ./with-dolfinx python3 demos/pantograph_catenary.py [--fast] [--json FILE] [--picture FILE] [--study FILE]

      messenger  ~~~~~~~.________.~~~~~~~      two wires as C^1 beams under tension, droppers that only pull,
                  |  |  |  |  |  |  |          the contact force as the multiplier of a point that slides along the wire
      contact  ------------------------        with up to 83 m/s and may lose it
                            o -> v
"""

import catenary_figures as figures
import catenary_model as model
import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check, say

args = demo.arguments(__doc__, {"--study": ""})
dt, spans, until = (4e-3, 3, 130.0) if args.fast else (2e-3, 10, 390.0)
RANGES = {  # km/h: (low, high) of the standard
    250: {"mean, N": (110, 120), "deviation, N": (26, 31), "statistical largest, N": (190, 210), "largest, N": (175, 210),
          "statistical smallest, N": (20, 40), "smallest, N": (50, 75), "uplift, mm": (48, 55)},
    300: {"mean, N": (110, 120), "deviation, N": (32, 40), "statistical largest, N": (210, 230), "largest, N": (190, 225),
          "statistical smallest, N": (-5, 20), "smallest, N": (30, 55), "uplift, mm": (55, 65)},
}  # fmt: skip


def drive(speed, h=dt, form=None):
    """One drive with constant steps."""
    scene = model.scene(speed, spans=spans)
    scheme = fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6, form=form or fmbd.Index3()))
    t_end = (until - 10.0) / speed + model.RAMP / 2
    return fmbd.solve(scene, t_end=t_end, dt=h, scheme=scheme, output=fmbd.Output(snapshots=8, energy=False))


section = (60.0, 120.0) if args.fast else (240.0, 360.0)
checks, runs = [], {}
for kmh, ranges in list(RANGES.items())[: 1 if args.fast else None]:
    v = kmh / 3.6
    run = runs[kmh] = drive(v)
    f = model.figures(run, v, section=section)
    top, low = f.statistical
    found = dict(zip(ranges, (f.mean, f.deviation, top, f.largest, low, f.smallest, f.uplift), strict=True))
    for name, (a, b) in ranges.items():
        inside = a <= found[name] <= b
        say(
            f"{kmh} km/h  {name:<24} {found[name]:7.1f}   standard {a} to {b}{'' if inside or args.fast else '   OUTSIDE'}"
        )
        if not args.fast:
            checks.append(Check(f"{kmh} km/h: {name}", found[name], (a + b) / 2, (b - a) / 2))
    checks.append(Check(f"{kmh} km/h: contact loss, %", f.loss, 0.0, 0.0))
    real_time = run.seconds["steps"] / run.times[-1]
    say(f"{kmh} km/h  {run.counters['steps']:.0f} steps, {real_time:.1f} times real time")
v = 250 / 3.6
fine = drive(v, h=dt / 2)
coarse_force, force = (model.low_pass(r.times, r["contact"][:, 0]) for r in (runs[250], fine))
inside = 10 + v * (runs[250].times - model.RAMP / 2) > 60
change = np.interp(runs[250].times, fine.times, force) - coarse_force
checks.append(Check("change of the filtered force with half the step, N", float(change[inside].std()), 0.0, 6.0))
stable = drive(v, form=fmbd.GGL())
apart = float((model.low_pass(stable.times, stable["contact"][:, 0]) - coarse_force)[inside].std())
checks.append(Check("GGL against index 3, filtered force, N", apart, 0.0, 1.0))
checks.append(Check("GGL: speed across the contact against index 3", stable.drift[1] / runs[250].drift[1], 0.0, 1e-2))
start = runs[250]["contact"][0, 0]
say(runs[250].report())
checks.append(Check("contact force at rest, N", start, model.STATIC_FORCE, 5.0))
if args.picture:
    figures.picture(runs, args.picture)
if args.study:
    figures.work(args.study)
demo.finish(checks, runs[250], args)
