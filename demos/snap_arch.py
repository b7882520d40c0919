r"""Snap of a shallow arch: the curve of load and deflection through both limit points, and the snap in time.

Run:  ./with-dolfinx python3 demos/snap_arch.py --picture arch.png

           F             two elastic struts, 1 kN/m each, half span 1 m, rise 0.3 m
         / | \           F = 2 k (l_0 / l - 1) y,    l = sqrt(1 + y^2)
       /   v   \         (von Mises' truss; y the height of the apex)

With the load as a function of time only, Newton's method ends at the limit; arc length goes on: the load turns back, pulls, and
rises again. In time the apex jumps where the static tangent becomes singular: under 0.999 of the limit load it stays up, under
1.001 of it, it goes through.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

RISE, STIFFNESS, LOAD, RAMP = 0.3, 1000.0, 50.0, 20.0
DAMPING = 2.0  # N s/m
LENGTH = np.hypot(1.0, RISE)


def build(load, damping=0.0):
    """The arch under a load (N) as a function of time (s)."""
    scene = fmbd.Scene("arch")
    apex = fmbd.RigidBody("apex", 0.1, 1.0, position=(0.0, RISE))
    scene.add(apex, fmbd.prismatic("guide", fmbd.ground, apex, axis=(0.0, 1.0)))
    for name, x in (("left", -1.0), ("right", 1.0)):
        how = {"stiffness": STIFFNESS, "damping": damping, "length": LENGTH}
        scene.add(fmbd.Spring(name, fmbd.ground, apex, point_a=(x, 0.0), point_b=(0.0, RISE), **how))
    scene.add(fmbd.force("load", apex, lambda t: (0.0, -load(t))))
    scene.sensor("apex", fmbd.position(apex))
    return scene


def load_of(y):
    """The load that holds the apex at height y (N)."""
    return 2.0 * STIFFNESS * (LENGTH / np.hypot(1.0, y) - 1.0) * y


def held_at(load):
    """Height of the apex (m) long after a load has grown smoothly to what it stays."""
    scene = build(lambda t: load * np.sin(0.5 * np.pi * min(t / RAMP, 1.0)) ** 2, DAMPING)
    return fmbd.solve(scene, t_end=2.0 * RAMP, dt=1e-2)["apex"][-1, 1]


def main():
    """The path, its limit points against the exact ones, and the start of the snap in time."""
    args = demo.arguments(__doc__)
    followed = fmbd.equilibrium(
        build(lambda t: LOAD * t), path=fmbd.ArcLength(1.0, step=0.01 if args.fast else 0.004, most=2000)
    )
    load, y = LOAD * np.array(followed.path.parameter), followed.path.series["apex"][:, 1]
    heights = np.linspace(-RISE, RISE, 200_001)
    limit, y_limit = load_of(heights).max(), heights[load_of(heights).argmax()]
    turns = LOAD * np.array(followed.path.limit_parameters)

    dt, kept = 4e-3 if args.fast else 1e-3, demo.snapshots(args)
    run = fmbd.solve(build(lambda t: LOAD * t / RAMP, DAMPING), t_end=0.4 * RAMP, dt=dt, output=kept)
    checks = [
        Check("curve against the exact one (N)", np.abs(load - load_of(y)).max(), 0.0, 1e-3),
        Check("limit points", len(turns), 2),
        Check.relative("first limit load (N)", turns[0], limit, 1e-3),
        Check.relative("second limit load (N)", turns[1], -limit, 1e-3),
        Check.at_least("height under 0.999 of the limit load, in time (m)", held_at(0.999 * limit), y_limit),
        Check.at_least("depth under 1.001 of it (m)", -held_at(1.001 * limit), RISE),
    ]
    if args.picture:
        wide = np.linspace(-0.45, RISE, 400)
        with plot.figure(args.picture, title=args.title) as axes:
            axes.plot(RISE - wide, load_of(wide), **plot.REFERENCE, label="exact")
            axes.plot(RISE - y, load, "k.-", ms=3, lw=0.8, label="arc length")
            axes.plot(RISE - run["apex"][:, 1], LOAD * run.times / RAMP, lw=0.8, label="slow load in time")
            axes.set(ylim=(-15, 25), xlabel="deflection of the apex (m)", ylabel="load (N)")
    demo.film(run, args, ["apex y"])
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
