"""Modes of mechanisms about their equilibria: a hung chain and a hung elastic rod.

Run:  ./with-dolfinx python3 demos/mechanism_modes.py --picture modes.png

   o       chain: n masses of 1 kg on massless links of 1 m; omega^2 L / g are the zeros of the Laguerre polynomial L_n
   |       rod:   1 m long, 5e7 Pa, on a pin, oblique gravity: found hanging, then its modes; its first period beside the
   o              rigid one, and that of a rigid rod beside a run of small amplitude
   |
   o
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

G = 9.81


def chain(n, dim=2):
    """n hanging links in the plane or in space."""
    scene, before = fmbd.Scene("chain", gravity=(0.0, -G, 0.0)[:dim]), fmbd.ground
    for i in range(n):
        inertia = 1e-12 if dim == 2 else (1e-8,) * 3
        mass = fmbd.RigidBody(f"mass {i}", 1.0, inertia, position=(0.0, -1.0 - i, 0.0)[:dim])
        scene.add(mass, fmbd.revolute(f"pin {i}", before, mass, center=(0.0, -float(i), 0.0)[:dim]))
        before = mass
    return scene


def rod(kind, h):
    """An elastic rod on a pin."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=h)
    body = kind("rod", mesh, density=1000.0, elastic=fmbd.materials.plane_stress(5e7, 0.3))
    scene = fmbd.Scene("rod", gravity=(0.0, -G))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


def period(run):
    """Period of the tip's swing, from its zero crossings (s)."""
    x, t = run["tip"][:, 0], run.times
    k = np.flatnonzero(x[1:] * x[:-1] < 0)
    cross = t[k] - x[k] * (t[k + 1] - t[k]) / (x[k + 1] - x[k])
    return 2.0 * (cross[-1] - cross[0]) / (len(cross) - 1)


def main():
    """Frequencies against closed forms, between placements, and against a run."""
    args = demo.arguments(__doc__)
    n = 4 if args.fast else 10
    exact = np.sqrt(G * np.polynomial.laguerre.lagroots([0] * n + [1]))
    plane, space = (fmbd.modes(s, n, at=fmbd.equilibrium(s)) for s in (chain(n), chain(n, 3)))

    scene = rod(fmbd.FloatingBody, 0.1)
    found = fmbd.modes(scene, 4, at=fmbd.equilibrium(scene))
    first = 2.0 * np.pi / found.omega[0]
    swing = fmbd.RigidBody("rod", 1.0, 1.0 / 12.0, position=(1e-3 / 2, -np.sqrt(1.0 - 1e-6) / 2), rotation=1e-3)
    rigid = fmbd.Scene("swing", gravity=(0.0, -G))
    rigid.add(swing, fmbd.revolute("pin", fmbd.ground, swing, center=(0.0, 0.0)))
    rigid.sensor("tip", fmbd.position(swing, point=(1e-3, -np.sqrt(1.0 - 1e-6))))
    run = fmbd.solve(rigid, t_end=5.0, dt=2e-3)
    still = fmbd.Scene("still", gravity=(0.0, -G))
    body = fmbd.RigidBody("rod", 1.0, 1.0 / 12.0, position=(0.0, -0.5))
    still.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0)))
    checks = [
        Check("chain, largest relative error", np.abs(plane.omega / exact - 1.0).max(), 0.0, 1e-8),
        Check("plane against space", np.abs(space.omega / plane.omega - 1.0).max(), 0.0, 1e-6),
        Check.relative("run of small amplitude (s)", period(run), 2 * np.pi / fmbd.modes(still, 1).omega[0], 1e-4),
        Check.relative("rod, first period (s)", first, 2 * np.pi * np.sqrt((1.0 + 0.01 / 4) * 2 / 3 / G), 0.02),
    ]
    if args.picture:
        with plot.figure(args.picture, title=args.title) as axes:
            for k in range(min(n, 5)):
                shape = np.real(plane.shapes[k].reshape(n, 3)[:, 0])
                axes.plot(np.r_[0, shape] + 2.5 * k, -np.arange(n + 1), "o-", label=f"{plane.omega[k]:.3f} rad/s")
            axes.set(ylabel="height (m)", xlabel="shapes of a chain, one beside the other, of any size", xticks=[])
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
