"""Spin-up: an arm is brought to 6 rad/s, above its first bending frequency of 3.8 rad/s; stiffening on and off.

Run:  ./with-dolfinx python3 demos/spin_up.py            (--picture spin_up.png; --fast: the beam only)

   hub (+)====================  arm: 10 m, EA 2.8e7 N, EI 1.4e4 N m^2, 1.2 kg/m
        |_) theta(t)

Steady rotation stretches the arm by tan(k) / k - 1 of its length, k^2 = rhoA Omega^2 L^2 / EA (elastic bar, exact). A linear
floating frame without the stress of the centrifugal forces loses its bending stiffness: the run ends with an error that
says so. Parameters: Simo and Vu-Quoc, doi:10.1115/1.3171871.
"""

from math import cos, pi, sin, sqrt, tan
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

L, EA, EI, RHO_A, RHO_I, GA = 10.0, 2.8e7, 1.4e4, 1.2, 6e-4, 1e7
OMEGA, T = 6.0, 15.0  # rad/s, s
HEIGHT = sqrt(12 * EI / EA)  # of a solid arm of unit depth


def motion(t):
    """theta, theta', theta'': smooth up to OMEGA at T, then steady."""
    if t >= T:
        return OMEGA * (t - T / 2), OMEGA, 0.0
    w = 2 * pi / T
    return (
        OMEGA / T * (t * t / 2 + (cos(w * t) - 1) / w**2),
        OMEGA / T * (t - sin(w * t) / w),
        OMEGA / T * (1 - cos(w * t)),
    )


def solid(stiffening):
    """A slender sheet in plane stress with the arm's EA and EI, in a frame attached to its root; 10 modes."""
    mesh = fmbd.read_gmsh(
        Path(__file__).resolve().parents[1] / "meshes/rod.py", dim=2, length=L, height=HEIGHT, h=L / 40
    )
    elastic = fmbd.materials.plane_stress(EA / HEIGHT, 0.3)
    body = fmbd.FloatingBody(
        "arm",
        mesh,
        density=RHO_A / HEIGHT,
        elastic=elastic,
        frame=fmbd.Attached("pin"),
        stiffening=stiffening,
    )
    return body.reduced(modes=10), "pin", "tip"


def beam(stiffening):
    """Ten Timoshenko elements."""
    section = fmbd.Section(EA=EA, EI=EI, rhoA=RHO_A, rhoI=RHO_I, GA=GA)
    return fmbd.Beam("arm", (0.0, 0.0), (L, 0.0), section, stiffening=stiffening), "start", "end"


def spin(arm, root, tip, dt=4e-3):
    """Tip displacement along and across the rotating axis (m) over time."""
    hub = fmbd.RigidBody("hub", mass=1.0, inertia=1.0, position=(0.0, 0.0))
    scene = fmbd.Scene("spin-up")
    scene.add(
        arm,
        hub,
        fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0)),
        fmbd.fixed("weld", hub, arm.surface(root)),
    )
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, hub, motion))
    scene.sensor("tip", fmbd.position(arm.surface(tip)))
    scene.sensor("hub", fmbd.rotation(hub))
    run = fmbd.solve(
        scene,
        t_end=20.0,
        dt=dt,
        scheme=fmbd.GeneralizedAlpha(0.9),
        output=fmbd.Output(every=2, estimate_error=False),
    )
    theta, x = np.array([motion(t)[0] for t in run.times]), run["tip"]
    return (
        run,
        np.cos(theta) * x[:, 0] + np.sin(theta) * x[:, 1] - L,
        np.cos(theta) * x[:, 1] - np.sin(theta) * x[:, 0],
    )


def refusal(arm):
    """The message of the run without stiffening."""
    try:
        spin(*arm)
    except fmbd.errors.ConvergenceError as error:
        return str(error)
    return ""


def main():
    args = demo.arguments(__doc__)
    k = sqrt(RHO_A * OMEGA**2 * L**2 / EA)
    checks, curves = [], {}
    for name, make in [("beam", beam)] if args.fast else [("beam", beam), ("solid", solid)]:
        run, stretch, deflection = spin(*make(True))
        curves[name] = run.times, deflection
        late = run.times > T
        smooth = np.hanning(late.sum())  # averages the vibration that is left
        mean = smooth @ stretch[late] / smooth.sum()
        checks.append(demo.Check.relative(f"{name}: steady stretch", mean, L * (tan(k) / k - 1), 1e-4))
        checks.append(demo.Check(f"{name}: largest deflection", deflection.min(), -0.5744, 2e-3))
        message = refusal(make(False))
        demo.say(f"{name} without stiffening: {message}")
        checks.append(demo.Check(f"{name}: refused without stiffening", float("stiffening=True" in message), 1.0, 0.0))
    if args.picture:
        from fmbd_fenicsx.faces.plot import plot_curves

        plot_curves(curves, args.picture, ("time (s)", "deflection of the tip (m)"))
    demo.finish(checks, run, args)


if __name__ == "__main__":
    main()
