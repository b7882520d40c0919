"""Frames of rods: a right-angle frame kicked out of its plane, a strip that buckles sideways, a four-bar that must bend.

Run:  ./with-dolfinx python3 demos/rod_frame.py [--fast] [--json FILE] [--picture FILE]

The scenes, their data and sources: ``rod_frame_model.py``. The strip is pulled along its stiff direction by a crank and a link,
offset by 0.1 mm. One hinge of the four-bar is turned by 5 degrees: rods against solids of the same data.
"""

import numpy as np
from rod_frame_model import corner, four_bar, poses, strip
from rod_model import panels

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post import demo

args = demo.arguments(__doc__)


def apart(name, runs):
    """Root mean square of the difference of two runs over that of the motion of the second."""
    a, b = (np.array([np.interp(runs[0].times, r.times, x) for x in r[name].T]).T for r in runs)
    return float(np.linalg.norm(a - b) / np.linalg.norm(b - b[0]))


t_end, h = (3.0, 0.02) if args.fast else (15.0, 0.02)
frames = [corner(n) for n in (2, 3)]
runs = [
    fmbd.solve(scene, t_end=t_end, dt=k, scheme=fmbd.GeneralizedAlpha(0.8), output=fmbd.Output(snapshots=4))
    for (scene, _), k in ((frames[0], h), (frames[0], h / 2), (frames[1], h / 2))
]
checks = [
    demo.Check("frame: tip, half of the step, 1", apart("tip", runs[:2]), 0.0, 0.02 if args.fast else 0.05),
    demo.Check("frame: tip, 3 elements a leg for 2, 1", apart("tip", runs[1:]), 0.0, 0.01 if args.fast else 0.05),
]
span = np.ptp(runs[2]["tip"][:, 2])
checks.append(demo.Check.at_least("frame: swing of the tip over the leg, 1", span / 10, 0.1))
energy = runs[2].total_energy[runs[2].times > 2.0]
checks.append(demo.Check("frame: energy lost after the kick, 1", 1 - energy[-1] / energy[0], 0.0, 0.02))

strips, k = [strip(n) for n in (4, 6)], 1e-3 if args.fast else 5e-4
until, kept, damped = 0.24 if args.fast else 0.4, fmbd.Output(snapshots=4), fmbd.GeneralizedAlpha(0.5)
buckled = [
    fmbd.solve(scene, t_end=until, dt=step, scheme=damped, output=kept)
    for (scene, _), step in zip(strips, (k, k / 2), strict=True)
]
aside = [np.abs(r["middle"][:, 1]).max() for r in buckled]
checks += [
    demo.Check.at_least("strip: sideways at mid span, m", float(aside[1]), 0.05),
    demo.Check("strip: middle, half of the step and 6 elements for 4, 1", apart("middle", buckled), 0.0, 0.05),
]

(rods, bars), (solids, _) = four_bar(solid=False), four_bar(solid=True)
turns = [fmbd.solve(x, t_end=2.4, dt=0.04 if args.fast else 0.02, scheme=damped, output=kept) for x in (rods, solids)]
away = [r["C"][:, 2] for r in turns]
checks += [
    demo.Check.at_least("four-bar: out of its plane, m", float(np.abs(away[0]).max()), 2e-3),
    demo.Check(
        "four-bar: the same, rods against solids, 1", np.abs(away[0] - away[1]).max() / np.abs(away[1]).max(), 0.0, 0.01
    ),
    demo.Check("four-bar: torque, rods against solids, 1", apart("torque", turns), 0.0, 0.02),
]

if args.picture:
    content = {}
    for title, run, rods in (
        ("right-angle frame", runs[2], frames[1][1]),
        ("buckling strip", buckled[1], strips[1][1]),
        ("four-bar", turns[0], bars),
    ):
        shapes = [[(rod, poses(run.system, s.q, rod)) for rod in rods] for s in run.snapshots]
        content[title] = [shape for moment in shapes for shape in moment]
    panels(args.picture, content, args.title)
demo.finish(checks, runs[2], args)
