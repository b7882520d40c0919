"""Spin-up: an arm is brought to 6 rad/s, above its first bending frequency of 3.8 rad/s; stiffening on and off.

Run:  ./with-dolfinx python3 demos/spin_up.py            (--picture spin_up.png; --fast: the beam only)

   hub (+)====================  arm: 10 m, EA 2.8e7 N, EI 1.4e4 N m^2, 1.2 kg/m
        |_) theta(t)

Steady rotation stretches the arm by tan(k) / k - 1 of its length, k^2 = rhoA Omega^2 L^2 / EA (elastic bar, exact). A linear
floating frame without the stress of the centrifugal forces loses its bending stiffness: the run ends with an error that
says so. Parameters: Simo and Vu-Quoc, doi:10.1115/1.3171871.
"""

from math import cos, pi, sin, sqrt, tan

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

L, EA, EI, RHO_A, RHO_I, GA = 10.0, 2.8e7, 1.4e4, 1.2, 6e-4, 1e7
OMEGA, T, LARGEST = 6.0, 15.0, -0.5744  # rad/s, s, m
HEIGHT = sqrt(12 * EI / EA)  # of a solid arm of unit depth


def motion(t):
    """theta, theta', theta'': smooth up to OMEGA at T, then steady."""
    if t >= T:
        return OMEGA * (t - T / 2), OMEGA, 0.0
    w, a = 2 * pi / T, OMEGA / T
    return a * (t * t / 2 + (cos(w * t) - 1) / w**2), a * (t - sin(w * t) / w), a * (1 - cos(w * t))


def solid(stiffening):
    """A slender sheet in plane stress with the arm's EA and EI, in a frame attached to its root; 10 modes."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, length=L, height=HEIGHT, h=L / 40)
    law = {"density": RHO_A / HEIGHT, "elastic": fmbd.materials.plane_stress(EA / HEIGHT, 0.3)}
    body = fmbd.FloatingBody("arm", mesh, **law, frame=fmbd.Attached("pin"), stiffening=stiffening)
    return body.reduced(modes=10), "pin", "tip"


def beam(stiffening):
    """Ten Timoshenko elements."""
    section = fmbd.Section(EA=EA, EI=EI, rhoA=RHO_A, rhoI=RHO_I, GA=GA)
    return fmbd.Beam("arm", (0.0, 0.0), (L, 0.0), section, stiffening=stiffening), "start", "end"


def spin(arm, root, tip):
    """The run, and the tip's displacement along and across the rotating axis over time, (2, n) m."""
    hub = fmbd.RigidBody("hub", mass=1.0, inertia=1.0, position=(0.0, 0.0))
    scene = fmbd.Scene("spin-up")
    scene.add(arm, hub, fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0)))
    scene.add(fmbd.fixed("weld", hub, arm.surface(root)), fmbd.drive_rotation("motor", fmbd.ground, hub, motion))
    scene.sensor("tip", fmbd.position(arm.surface(tip)))
    output = demo.snapshots(args, every=2, estimate_error=False)
    run = fmbd.solve(scene, t_end=20.0, dt=4e-3, scheme=fmbd.GeneralizedAlpha(0.9), output=output)
    theta = np.array([motion(t)[0] for t in run.times])
    turned = np.exp(-1j * theta) * (run["tip"] @ [1, 1j])
    return run, np.array([turned.real - L, turned.imag])


args = demo.arguments(__doc__)
k = sqrt(RHO_A * OMEGA**2 * L**2 / EA)
steady, checks, curves = L * (tan(k) / k - 1), [], {}
for name, make in [("beam", beam)] if args.fast else [("beam", beam), ("solid", solid)]:
    run, (stretch, deflection) = spin(*make(True))
    late = run.times > T
    smooth = np.sqrt(np.hanning(late.sum()))  # averages the vibration that is left; it shortens the arm by its square
    at_rest = np.polyfit(deflection[late] ** 2, stretch[late], 1, w=smooth)[1]
    checks.append(Check.relative(f"{name}: steady stretch", at_rest, steady, 1e-4))
    checks.append(Check(f"{name}: largest deflection", deflection.min(), LARGEST, 2e-3))
    try:
        spin(*make(False))
        message = ""
    except fmbd.errors.ConvergenceError as error:
        message = str(error)
    demo.say(f"{name} without stiffening: {message}")
    checks.append(Check(f"{name}: refused without stiffening", float("stiffening=True" in message), 1.0))
    curves[name] = run.times, stretch, deflection
if args.picture:
    with plot.figure(args.picture, 2, 1, size=(7.0, 6.0), title=args.title) as (above, below):
        above.axhline(LARGEST, **plot.REFERENCE, label="largest, reference")
        below.axhline(1e3 * steady, **plot.REFERENCE, label="steady rotation, elastic bar")
        for (name, (t, stretch, deflection)), style in zip(curves.items(), ("-", "--"), strict=False):
            above.plot(t, deflection, style, label=name)
            below.plot(t, 1e3 * stretch, style, label=name)
        above.set(ylabel="tip across the axis (m)")
        below.set(ylabel="tip along the axis (mm)", xlabel="time (s); full speed from 15 s on")
demo.finish(checks, run, args)
