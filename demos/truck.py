"""Truck over a hump: rigid bodies on a suspension, then with an elastic loading area on the same suspension.

Run:  ./with-dolfinx python3 demos/truck.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]   (or mpirun -n 2 ...)
      ./with-dolfinx python3 demos/truck.py --fast --coordinates FILE      (the nine coordinates every 0.1 s, to 1e-11)
      ./with-dolfinx python3 demos/truck.py --fast --study FILE            (error against run time, and its figure)

         ___________________      _____
        |   loading area    |    | cab |        pinned to the chassis at the rear and sprung in front,
        |__pin______spring__|____|_____|        or on three springs; the road lifts the tyres by 12 cm
         ====o=====chassis==========o===
            (_)rear                (_)front

Reference of the rigid truck: nine coordinates, forces by virtual work, order 8 and 1e-12 (tests/truck_reference.py).
"""

import json
from pathlib import Path

import numpy as np
import truck_figures as figures
import truck_model as model

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check, say
from fmbd_fenicsx.ranks import world_rank

args = demo.arguments(__doc__, {"--coordinates": "", "--study": ""})
t_end, dt, size = (2.0, 4e-2, 0.6) if args.fast else (10.0, 1e-2, 0.3)
SUSPENSIONS = {"pin and spring": True, "three springs": False}


def drive(load, pinned, modulus=model.MODULUS, snapshots=0):
    """One drive."""
    scene = model.truck(load, pinned=pinned, modulus=modulus)
    return fmbd.solve(scene, t_end=t_end, dt=dt, output=fmbd.Output(snapshots=snapshots, energy=False))


def deviation(a, b, sensor="cab"):
    """Largest difference over the drive."""
    return float(abs(a[sensor] - b[sensor]).max())


def unbalanced(pin):
    """Largest force (N) out of balance at the start; ``pin``: forces of the pin on the loading area, or None."""
    system, start, _ = model.truck(model.rigid_load(), pinned=pin is not None).build()
    forces = system.at(0.0, start.q, start.v).balance(start.a).reshape(-1, 3)[:, :2]
    if pin is not None:
        order = list(system.frame_names)
        forces[order.index("chassis")] += pin[0]
        forces[order.index("load")] -= pin[0]
    return abs(forces).max()


checks, runs, soft = [], {}, model.elastic_load(h=size)
for (name, pinned), expected in zip(SUSPENSIONS.items(), model.NINE_AT[t_end], strict=True):
    found = model.nine_coordinates([0.0, t_end], pinned=pinned)
    error = abs(found["p"][-1] - expected).max()
    checks.append(Check(f"{name}: nine coordinates at the end, m, rad", error, 0.0, 1e-11))
    digits = 1e-9 if pinned else 1e-8  # the source prints the nominal forces of the two rear springs to 1e-8 N
    checks.append(Check(f"{name}: out of balance at the start, N", unbalanced(found.get("pin")), 0.0, digits))
    if pinned:
        checks.append(Check.relative("pin force at the start, N", found["pin"][0, 1], model.PIN_FORCE, 1e-9))
    rigid, full = drive(model.rigid_load(), pinned), drive(soft, pinned, snapshots=4)
    runs[name] = rigid, full
    far = [deviation(drive(model.elastic_load(E, h=size), pinned, E), rigid) for E in (1e9, 1e10)]
    checks.append(Check(f"{name}: rigid limit, deviations of E and 10 E", far[0] / far[1], 10.0, 0.5))
    errors = []
    for modes in (0, 2, 6):  # what more leave is less than what Newton's iteration does
        few = drive(soft.reduced(basis=fmbd.CraigBampton(("rear", "front"), modes, inertia=True)), pinned)
        errors.append(deviation(full, few, "stress"))
        say(f"{name}, static and {modes:2d} more modes: cab {deviation(full, few):.1e} m, stress {errors[-1]:.1e} N/m")
    checks.append(Check(f"{name}: stress without vibration modes", errors[0] / full["stress"].max(), 0.0, 1e-4))
    checks.append(Check(f"{name}: stress error falls with the modes", float((np.diff(errors) < 0).all()), 1.0, 0.0))
    driver = abs(full["cab acceleration"][:, 1]).max()
    say(f"{name}: cab acceleration up to {driver:.3g} m/s^2, stress up to {full['stress'].max():.5g} N/m")
if args.coordinates:
    times = np.linspace(0.0, 10.0, 101)
    found = {name: model.nine_coordinates(times, pinned=pinned) for name, pinned in SUSPENSIONS.items()}
    if world_rank() == 0:
        content = {name: {k: x.tolist() for k, x in one.items()} for name, one in found.items()}
        Path(args.coordinates).write_text(json.dumps(content) + "\n")
if args.picture:
    figures.picture(runs, args.picture)
if args.study:
    figures.work(args.study, t_end)
if args.animate:
    demo.film(drive(soft, True, snapshots=100), args, ["cab", "stress"])
demo.finish(checks, full, args)
