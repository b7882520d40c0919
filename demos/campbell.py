r"""Campbell's diagrams: a turning blade, a shaft with a disc, a spinning top; forward and backward whirl told apart.

Run:  ./with-dolfinx python3 demos/campbell.py --picture campbell.png

      |=========   blade on a hub that turns with mu sqrt(EI / rho A L^4): stiffened by centrifugal force, flapwise
    __|_________    reference of Euler and Bernoulli's beam for mu = 2 ... 50
                   shaft: tube of 6 m, disc of 70 kg, ends held against tilting; critical speed 56.853 rad/s
      \ | /        top, upright: A w^2 - C s w + m g l = 0 for precession and nutation
       \|/

Data: Hamza-cherif and Houmat, ICAS 2004, table 2 (blade); doi:10.1007/s11044-016-9514-y (shaft).
"""

import matplotlib.pyplot as plt
import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check

MU = np.array([2.0, 4.0, 6.0, 8.0, 10.0, 50.0])
FLAPWISE = np.array([4.1373, 5.585, 7.3603, 9.2568, 11.2023, 51.0805])
SLENDER = 1000.0
UNIT = 1.0 / SLENDER  # sqrt(EI / rho A L^4) of a blade with E = rho = A = L = 1


def blade(elements):
    """A slender blade along x on the ground, which turns about z."""
    bending = UNIT**2
    stiffness = (1.0, 1 / 3.12, 1 / 3.12, bending / 1.3, bending, bending)
    section = fmbd.RodSection(stiffness, 1.0, bending * np.array([2.0, 1.0, 1.0]))
    rod = fmbd.Rod("blade", [(0, 0, 0), (1, 0, 0)], section, elements=elements)
    scene = fmbd.Scene("blade")
    scene.add(rod, fmbd.fixed("hub", fmbd.ground, rod.surface("start")))
    return scene


def shaft(elements):
    """The tube with its disc in bearings that turn with it."""
    area, moment = np.pi * (0.05**2 - 0.045**2), np.pi / 4 * (0.05**4 - 0.045**4)
    stiffness = (3.134e8, 6.05e7, 6.05e7, 2.727e5, 3.545e5, 3.545e5)
    tube = fmbd.RodSection(stiffness, 7800 * area, 7800 * moment * np.array([2, 1, 1]))
    rod = fmbd.Rod("shaft", [(0, 0, 0), (6, 0, 0)], tube, elements=elements, stations={"middle": 3.0})
    mass, radius, width = 70.573, 0.24, 0.05
    across = mass * (3 * radius**2 + width**2) / 12
    disc = fmbd.RigidBody("disc", mass, (0.5 * mass * radius**2, across, across), position=(3, 0, 0))
    scene = fmbd.Scene("shaft")
    scene.add(rod, disc, fmbd.fixed("bearing", fmbd.ground, rod.surface("start")))
    scene.add(fmbd.fixed("hub", rod.surface("middle"), disc, center=(3, 0, 0)))
    scene.add(fmbd.prismatic("guide", fmbd.ground, rod.surface("end"), axis=(1, 0, 0)))
    return scene


def top(spin, m=1.0, length=0.3, A=0.12, C=0.02):
    """Upright top with a spin (rad/s), and its exact precession and nutation (rad/s)."""
    J = (A - m * length**2, A - m * length**2, C)
    body = fmbd.RigidBody("top", m, J, (0, 0, length), angular_velocity=(0, 0, spin))
    scene = fmbd.Scene("top", gravity=(0, 0, -9.81))
    scene.add(body, fmbd.spherical("pivot", fmbd.ground, body, center=(0, 0, 0)))
    return scene, np.sort(np.roots([A, -C * spin, m * 9.81 * length]).real)


def main():
    """Blade to 1 % up to mu = 50, shaft to 0.1 %, top to 1e-6."""
    args = demo.arguments(__doc__)
    n = 6 if args.fast else 12
    blades = fmbd.campbell(lambda _: blade(n), MU * UNIT, 2)
    flap = blades.omega[:, 1] / UNIT  # the first is chordwise

    about = fmbd.Spin(0.0, axis=(1.0, 0.0, 0.0))
    speeds = np.array([0.0, 30.0, 55.0, 60.0, 80.0])
    turned = fmbd.campbell(lambda _: shaft(4 if args.fast else 8), speeds, 2, spin=about)

    scene, exact = top(60.0)
    found = np.sort(fmbd.modes(scene, 4).omega)[-2:]
    checks = [
        *(Check.relative(f"flapwise at mu = {m:g}", w, r, 1e-2) for m, w, r in zip(MU, flap, FLAPWISE, strict=True)),
        Check("critical speeds of the shaft", len(turned.critical_speeds), 1),
        Check.relative("critical speed (rad/s)", turned.critical_speeds[0], 56.853, 1e-3),
        Check.relative("backward whirl at 30 rad/s (rad/s)", turned.fixed[1].min(), -56.853, 1e-3),
        *(
            Check.relative(f"{name} of the top (rad/s)", w, r, 1e-6)
            for name, w, r in zip(("precession", "nutation"), found, exact, strict=True)
        ),
    ]
    if args.picture:
        _, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
        (
            left.loglog(MU, FLAPWISE, "ko", mfc="none", label="reference, flapwise"),
            left.loglog(MU, flap, label="rod, flapwise"),
        )
        left.loglog(MU, blades.omega[:, 0] / UNIT, "--", label="rod, chordwise")
        left.set(xlabel="mu", ylabel="frequency / sqrt(EI / rho A L^4)"), left.legend()
        right.plot(speeds, turned.fixed.max(axis=1), "o-", label="forward")
        right.plot(speeds, np.abs(turned.fixed.min(axis=1)), "s--", label="backward")
        right.plot(speeds, speeds, "k:", label="speed"), right.axvline(56.853, color="r", lw=0.8, label="critical")
        right.set(xlabel="speed of the shaft (rad/s)", ylabel="whirl seen at rest (rad/s)"), right.legend()
        plt.tight_layout(), plt.savefig(args.picture, dpi=120)
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
