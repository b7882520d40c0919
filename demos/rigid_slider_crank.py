"""Rigid slider crank that coasts, and the one with equal arms through its dead centres.

Run:  ./with-dolfinx python3 demos/rigid_slider_crank.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

Data of the slider crank of the IVP test set (crank 0.15 m, rod 0.30 m, 150 rad/s, no gravity). With one degree of freedom the
energy 1/2 I(phi) phi'^2 = E gives the time of a turn by a quadrature. With equal arms G loses rank at phi = 90 and 270 degrees.
"""

import numpy as np
from scipy.integrate import quad

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
turns, per_turn = (1, 400) if args.fast else (4, 800)
R, SPEED = 0.15, 150.0
M1, M2, M3 = 0.36, 0.151104, 0.075552
J1, J2 = 0.002727 - M1 * R**2 / 4, 0.0045339259 - M2 * 0.15**2  # about the centres of mass


def motion(phi, arm):
    """Velocities of (rod angle, rod centre x, y, slider) for phi' = 1."""
    inner = np.arcsin(R * np.sin(phi) / arm) if arm != R else phi
    rate = R * np.cos(phi) / (arm * np.cos(inner)) if arm != R else 1.0
    half = 0.5 * arm * rate
    x, y = -R * np.sin(phi) - half * np.sin(inner), R * np.cos(phi) - half * np.cos(inner)
    return -rate, x, y, x - half * np.sin(inner)


def pace(phi, arm):
    """sqrt(I(phi)), kg^1/2 m; phi' is SPEED at phi = 0, so that dt = pace(phi) / pace(0) / SPEED dphi."""
    w, x, y, s = motion(phi, arm)
    return np.sqrt(J1 + M1 * R**2 / 4 + J2 * w**2 + M2 * (x**2 + y**2) + M3 * s**2)


def scene(arm):
    """The mechanism stretched along x, turning."""
    w, _, y, _ = motion(0.0, arm)
    crank = fmbd.RigidBody("crank", M1, J1, (R / 2, 0), velocity=(0, SPEED * R / 2), angular_velocity=SPEED)
    rod = fmbd.RigidBody("rod", M2, J2, (R + arm / 2, 0), velocity=(0, SPEED * y), angular_velocity=SPEED * w)
    block = fmbd.RigidBody("block", M3, 1e-4, (R + arm, 0), shape=fmbd.contacts.Box((0.06, 0.04)))
    made = fmbd.Scene(f"slider crank {R} : {arm}")
    pin = fmbd.revolute("pin", fmbd.ground, crank, center=(0, 0))
    made.add(crank, rod, block, pin, fmbd.revolute("knee", crank, rod, center=(R, 0)))
    made.add(fmbd.revolute("wrist", rod, block, center=(R + arm, 0)))
    made.add(fmbd.prismatic("slider", fmbd.ground, block, axis=(1, 0), center=(R + arm, 0)))
    made.sensor("phi", fmbd.angle(pin))
    made.sensor("slider", fmbd.position(block))
    return made


checks = []
for arm in (0.30, R):
    turn = quad(pace, 0, 2 * np.pi, (arm,), epsabs=1e-14, limit=400)[0] / (pace(0.0, arm) * SPEED)  # s
    made = {"t_end": turns * turn, "output": snapshots(args)}
    coarse, run = (fmbd.solve(scene(arm), dt=turn / k, **made) for k in (per_turn, 2 * per_turn))
    once, twice = coarse["phi"][-1, 0], run["phi"][-1, 0]
    e, name = run.energy["kinetic"], "equal arms: " if arm == R else ""
    checks += [
        Check(f"{name}angle after {turns} turns, rad", twice, 2 * np.pi * turns, 1e-3 * turns),
        Check(f"{name}the same, extrapolated, rad", (4 * twice - once) / 3, 2 * np.pi * turns, 1e-6 * turns),
        Check(f"{name}energy error, 1", np.abs(e / e[0] - 1).max(), 0.0, 1e-3),
        Check(f"{name}constraint, m", run.drift[0], 0.0, 1e-12),
    ]
fold = np.abs(run["slider"][:, 0] - 2 * R * np.cos(run["phi"][:, 0])).max()
checks.append(Check("equal arms: change of branch, m", fold, 0.0, 1e-9))
known = {"phi": (turn * np.arange(turns + 1), 2 * np.pi * np.arange(turns + 1))}
show(run, args, ["slider x", "phi"], reference=known, view=fmbd.View(instants=4))
finish(checks, run, args)
