"""Dry friction in a sprung hinge: analytic decay, rest away from zero; smooth friction beside it creeps.

Run:  ./with-dolfinx python3 demos/hinge_friction.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

    J x'' + k x = -F sign(x'): half cycles about +-F/k, amplitudes fall by 2 F/k each, until |k x| < F at a turning point
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, film, finish, snapshots

args = arguments(__doc__)
J, k, F, start = 0.5, 20.0, 1.8, 1.0  # kg m^2, N m/rad, N m, rad
t_end, dt = 3.6, 2e-3 if args.fast else 1e-3
omega, shift = np.sqrt(k / J), F / k


def exact(t):
    """Angle of the hinge from its start, (n,)."""
    halves = int(np.ceil((start - shift) / (2 * shift)))  # half cycles until it sticks
    n = np.minimum((np.atleast_1d(t) * omega / np.pi).astype(int), halves)
    top = start - 2 * n * shift
    wave = np.where(n == halves, top, (top - shift) * np.cos(omega * t - n * np.pi) + shift)
    return start - (-1.0) ** n * wave


def hinge(name, friction):
    """A wheel on a hinge with a spring that pulls to ``start``, and friction."""
    wheel = fmbd.RigidBody("wheel", 1.0, J, shape=fmbd.contacts.Box((1.0, 0.12)))
    scene = fmbd.Scene(name)
    joint = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0))
    element = friction(fmbd.angle(joint))
    scene.add(wheel, joint, element, fmbd.joint_spring("spring", fmbd.angle(joint), stiffness=k, free=start))
    scene.sensor("angle", fmbd.angle(joint))
    scene.sensor("friction", fmbd.element_effort(element))
    return fmbd.solve(scene, t_end=t_end, dt=dt, output=snapshots(args))


dry = hinge("dry friction", lambda s: fmbd.dry_friction("friction", s, limit=F, stick=1e6, damping=500.0))
smooth = hinge("smooth friction", lambda s: fmbd.joint_friction("friction", s, coulomb=F, speed=0.05))
rest = exact(dry.times)[-1] - start
last = len(dry.times) // 20
checks = [
    Check(
        "decay against the formula, rad",
        np.abs(dry["angle"][:, 0] - exact(dry.times)).max(),
        0.0,
        6e-3 if args.fast else 2e-3,
    ),
    Check("angle at rest from the spring's zero, rad", dry["angle"][-1, 0] - start, rest, 2e-3),
    Check("friction that holds the spring, N m", dry["friction"][-1, 0], k * rest, 2e-2),
    Check("creep at rest, rad", np.ptp(dry["angle"][-last:, 0]), 0.0, 1e-9),
    Check.at_least("creep of smooth friction, rad", np.ptp(smooth["angle"][-last:, 0]), 1e-6),
]
if args.picture:
    dry.plot("angle", "friction", file=args.picture, reference={"angle": exact})
film(dry, args, ["angle", "friction"])
finish(checks, dry, args)
