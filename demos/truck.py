"""Truck over a hump: rigid bodies on a suspension, then with an elastic loading area on the same suspension.

Run:  ./with-dolfinx python3 demos/truck.py [--fast] [--json FILE] [--picture FILE]   (or mpirun -n 2 ...)

         ___________________      _____
        |   loading area    |    | cab |        pinned to the chassis at the rear and sprung in front,
        |__pin______spring__|____|_____|        or on three springs; the road lifts the tyres by 12 cm
         ====o=====chassis==========o===
            (_)rear                (_)front

Reference of the rigid truck: nine coordinates, forces by virtual work, order 8 and 1e-12 (tests/truck_reference.py).
"""

import truck_model as model

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.faces.demo import Check, arguments, finish, say

args = arguments(__doc__)
t_end, dt = (2.0, 1e-2) if args.fast else (10.0, 5e-3)
CAB = {2.0: (2.908354490237979, 2.908230786855053), 10.0: (2.940619120586877, 2.9362140954371196)}  # pinned, on springs
PIN_FORCE = 68056.2088888888  # N, at the start


def run(load, pinned=True, modulus=model.MODULUS, h=dt):
    """One drive."""
    scene = model.truck(load, pinned=pinned, modulus=modulus)
    return fmbd.solve(scene, t_end=t_end, dt=h, output=fmbd.Output(snapshots=4, energy=False))


def deviation(a, b, sensor="cab"):
    """Largest difference over the drive."""
    return float(abs(a[sensor] - b[sensor]).max())


checks = []
rigid = {}
for pinned, reference in zip((True, False), CAB[t_end], strict=True):
    coarse, rigid[pinned] = (run(model.rigid_load(), pinned, h=h) for h in (2 * dt, dt))
    name = "pinned" if pinned else "on springs"
    better = (4 * rigid[pinned]["cab"][-1, 1] - coarse["cab"][-1, 1]) / 3
    checks.append(Check(f"{name}: cab at the end, extrapolated, m", better, reference, 1e-7))
    system, start, _ = model.truck(model.rigid_load(), pinned=pinned).build()
    ev = system.at(0.0, start.q, start.v)
    forces = ev.balance(start.a).reshape(-1, 3)[:, :2]
    order = list(system.frame_names)
    if pinned:
        forces[order.index("chassis")] -= rigid[True]["pin"][0]
        forces[order.index("load")] += rigid[True]["pin"][0]
    digits = 1e-9 if pinned else 1e-8  # the source prints the nominal forces of the two rear springs to 1e-8 N
    checks.append(Check(f"{name}: forces out of balance at the start, N", abs(forces).max(), 0.0, digits))
checks.append(Check.relative("pin force at the start, N", -rigid[True]["pin"][0, 1], PIN_FORCE, 1e-9))

stiffer = {E: deviation(run(model.elastic_load(E), modulus=E), rigid[True]) for E in (1e9, 1e10)}
checks.append(Check("rigid limit: ratio of deviations, E and 10 E", stiffer[1e9] / stiffer[1e10], 10.0, 0.5))
soft = model.elastic_load()
full = run(soft)
say(full.report())
errors = []
for modes in (0, 6, 24):
    basis = fmbd.CraigBampton(("rear", "front"), modes)
    few = run(soft.reduced(basis=basis))
    errors.append(deviation(full, few, "stress"))
    say(f"interface modes and {modes:2d} more: cab {deviation(full, few):.1e} m, stress {errors[-1]:.1e} N/m")
checks.append(Check("24 modes: cab against the full field, m", deviation(full, few), 0.0, 1e-6))
checks.append(Check("stress error falls with the modes", float(errors == sorted(errors, reverse=True)), 1.0, 0.0))
checks.append(Check.relative("24 modes: largest stress, N/m", few["stress"].max(), full["stress"].max(), 2e-2))
say(
    f"cab acceleration up to {abs(full['cab acceleration'][:, 1]).max():.3g} m/s^2, stress up to {full['stress'].max():.4g} N/m"
)
if args.picture:
    model.picture(full, rigid[True], args.picture)
finish(checks, full, args)
