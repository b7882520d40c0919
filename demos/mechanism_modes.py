"""Modes of mechanisms about their equilibria: a hung chain, and an elastic four-bar mechanism.

Run:  ./with-dolfinx python3 demos/mechanism_modes.py --picture modes.png

   o   o        chain: n masses of 1 kg on massless links of 1 m; omega^2 L / g are the zeros of the Laguerre polynomial L_n
   |   |   o    four-bar: two unequal legs and an elastic coupler of 50 MPa that sags by its weight; found hanging, then its
   o   |   |    modes, beside the frequencies fitted to a run in which it was kicked and tapped a little (0.1 mm)
   |   o===o
   o
"""

import numpy as np
from scipy.optimize import least_squares

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import Check, demo, plot

G = 9.81


def chain(n, dim=2):
    """n hanging links in the plane or in space."""
    scene, before = fmbd.Scene("chain", gravity=(0.0, -G, 0.0)[:dim]), fmbd.ground
    for i in range(n):
        mass = fmbd.RigidBody(f"mass {i}", 1.0, 1e-12 if dim == 2 else (1e-8,) * 3, position=(0.0, -1.0 - i, 0.0)[:dim])
        scene.add(mass, fmbd.revolute(f"pin {i}", before, mass, center=(0.0, -float(i), 0.0)[:dim]))
        before = mass
    return scene


def four_bar(kick=0.0, full=False):
    """Two legs and an elastic coupler, hanging at rest; pushed by ``kick`` N for a twentieth of a second."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.05), origin=(0.0, -0.525), counts=(10, 1))
    coupler = fmbd.FloatingBody("coupler", mesh, density=1000.0, elastic=fmbd.materials.plane_stress(5e7, 0.3))
    coupler = coupler if full else coupler.reduced(basis=fmbd.CraigBampton(("left", "right"), 4))
    scene = fmbd.Scene("four-bar", gravity=(0.0, -G), settle=True)
    scene.add(coupler)
    for side, x, top in (("left", 0.0, 0.0), ("right", 1.0, 0.1)):
        length = top + 0.5
        leg = fmbd.RigidBody(f"{side} leg", 5.0, 5.0 * length**2 / 12, position=(x, top - length / 2))
        scene.add(leg, fmbd.revolute(f"{side} pivot", fmbd.ground, leg, center=(x, top)))
        scene.add(fmbd.revolute(f"{side} hinge", leg, coupler.surface(side), center=(x, -0.5)))

    def pulse(t):
        return kick * np.sin(np.pi * min(20.0 * t, 1.0)) ** 2

    scene.add(fmbd.force("kick", scene.bodies["left leg"], lambda t: (pulse(t), 0.0)))
    scene.add(fmbd.force("tap", coupler.surface("bottom"), lambda t: (0.0, -10.0 * pulse(t))))
    scene.sensor("middle", fmbd.position(coupler.surface("bottom")))
    return scene


def fitted(run, guess):
    """Angular frequencies (rad/s) of the free motion after the push, nearest to a guess."""
    late = run.times > 0.05
    t, x = run.times[late], run["middle"][late] - run["middle"][late].mean(axis=0)
    x = x / np.abs(x).max(axis=0)

    def left(omega):
        A = np.column_stack([np.ones_like(t), *(wave(w * t) for w in omega for wave in (np.cos, np.sin))])
        return (x - A @ np.linalg.lstsq(A, x, rcond=None)[0]).ravel()

    return least_squares(left, guess, x_scale=1e-3).x


args = demo.arguments(__doc__)
n = 4 if args.fast else 10
exact = np.sqrt(G * np.polynomial.laguerre.lagroots([0] * n + [1]))
plane, space = (fmbd.modes(s, n, at=fmbd.equilibrium(s)) for s in (chain(n), chain(n, 3)))

reduced, whole = (fmbd.equilibrium(four_bar(full=full)) for full in (False, True))
found, field = (fmbd.modes(at.scene, count, at=at) for at, count in ((reduced, 3), (whole, 2)))
run = fmbd.solve(four_bar(0.2), t_end=4.0, dt=5e-4, scheme=fmbd.GeneralizedAlpha(0.95))
seen = fitted(run, 1.003 * found.omega[:2])
checks = [
    Check("chain, largest relative error", np.abs(plane.omega / exact - 1.0).max(), 0.0, 1e-8),
    Check("plane against space", np.abs(space.omega / plane.omega - 1.0).max(), 0.0, 1e-6),
    Check.relative("four-bar, swing in a run (rad/s)", seen[0], found.omega[0], 1e-4),
    Check.relative("four-bar, bending in a run (rad/s)", seen[1], found.omega[1], 1e-4),
    Check.relative("bending without reduction (rad/s)", field.omega[1], found.omega[1], 1e-4),
]
if args.picture:
    with plot.figure(args.picture, title=args.title) as axes:
        for k in range(min(n, 5)):
            shape = np.real(plane.shapes[k].reshape(n, 3)[:, 0])
            axes.plot(np.r_[0, shape] + 2.5 * k, -np.arange(n + 1), "o-", label=f"{plane.omega[k]:.3f} rad/s")
        axes.set(ylabel="height (m)", xlabel="shapes of a chain, one beside the other, of any size", xticks=[])
demo.finish(checks, None, args)
