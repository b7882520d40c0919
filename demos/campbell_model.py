"""Rotating scenes with known frequencies: a blade, a shaft with a disc, a top, a free disc; data and figure of the demo campbell.

Sources: Hamza-cherif and Houmat, ICAS 2004, table 2 (blade); doi:10.1007/s11044-016-9514-y (shaft); Bhuta and Jones,
J. Acoust. Soc. Am. 35 (1963) 982 (symmetric motions of a disc in its plane).
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import jv, jvp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import plot
from fmbd_fenicsx.materials import plane_stress

SLENDER = 1000.0
UNIT = 1.0 / SLENDER  # sqrt(EI / rho A L^4) of a blade with E = rho = A = L = 1
MU = np.array([2.0, 4.0, 6.0, 8.0, 10.0, 50.0])
FLAPWISE = np.array([4.1373, 5.585, 7.3603, 9.2568, 11.2023, 51.0805])  # of Euler and Bernoulli's beam, over UNIT

NU = 0.3
PRESSURE, SHEAR = 1.0 / (1.0 - NU**2), 0.5 / (1.0 + NU)  # squared speeds of waves in a plate with E = rho = 1


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


def disc(h, kind=fmbd.FloatingBody):
    """A free round plate of radius 1 m, E = rho = 1, in its plane."""
    mesh = fmbd.read_gmsh("meshes/disc.py", h=h)
    scene = fmbd.Scene("disc")
    scene.add(kind("disc", mesh, degree=2, density=1.0, elastic=plane_stress(1.0, NU)))
    return scene


def edge(omega, spin):
    """Zero at the frequencies of motions that are the same all around, for a disc of radius 1 m.

    Radial u = J_1(k r) and tangential i w J_1(k r) in turning axes, with a = omega^2 + spin^2:
    (c_p^2 k^2 - a) u = 2 omega spin w,   (c_s^2 k^2 - a) w = 2 omega spin u;   no stress at the edge.
    """
    a, turn = omega**2 + spin**2, 2.0 * omega * spin
    columns = []
    for k2 in np.roots([PRESSURE * SHEAR, -(PRESSURE + SHEAR) * a, a * a - turn**2]).real:
        k = np.sqrt(complex(k2))
        w, slope = (PRESSURE * k2 - a) / turn, k * jvp(1, k)
        columns.append((slope + NU * jv(1, k), (slope - jv(1, k)) * w))
    return float(np.linalg.det(np.array(columns).T).real)


def symmetric(spin):
    """Breathing and twisting frequency of the disc (rad/s) in axes that turn with it."""
    grid = np.linspace(1.5, 4.0, 200)
    at = [edge(x, spin) for x in grid]
    changes = [i for i in range(len(at) - 1) if at[i] * at[i + 1] < 0]
    return [float(brentq(edge, grid[i], grid[i + 1], args=(spin,))) for i in changes]


def picture(args, blades, speeds, turned, plates, omega):
    """Frequencies over speeds."""
    with plot.figure(args.picture, 1, 3, size=(13.0, 4.4), title=args.title) as (left, middle, right):
        left.loglog(MU, FLAPWISE, "ko", mfc="none", label="flapwise, reference")
        left.loglog(blades.speeds / UNIT, blades.omega[:, 1] / UNIT, "C0.", label="flapwise")
        left.loglog(blades.speeds / UNIT, blades.omega[:, 0] / UNIT, "C1x", label="chordwise")
        left.set(xlabel="blade: spin over the unit of frequency", ylabel=r"frequency / $\sqrt{EI / \rho A L^4}$")

        middle.plot(speeds, turned.fixed.max(axis=1), "o-", label="forward whirl")
        middle.plot(speeds, np.abs(turned.fixed.min(axis=1)), "s--", label="backward")
        middle.plot(speeds, speeds, "k:", label="speed")
        middle.axvline(56.853, color="r", lw=0.8, label="critical, reference")
        middle.set(xlabel="shaft: speed (rad/s)", ylabel="whirl seen at rest (rad/s)")

        fine = np.linspace(0.02, 0.32, 16)
        lines = right.plot(fine, [symmetric(w) for w in fine], **plot.REFERENCE)
        dots = right.plot(plates, omega, "o", mfc="none", color="C0")
        lines[0].set_label("Bessel's functions"), dots[0].set_label("elements")
        right.set(xlabel="free disc: spin (rad/s)", ylabel="breathing, twisting, turning axes (rad/s)")
