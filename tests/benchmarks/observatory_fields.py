"""Problems of the observatory: tops and a governor in space, elastic bars, beams and rods, impacts; nearly all exact.

Errors of elastic problems hold that of the mesh: finer steps do not bring them to zero.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from observatory_motions import top, top_end
from observatory_problem import Problem
from scipy.integrate import quad, solve_ivp

import fmbd_fenicsx as fmbd

G = 9.81
MESHES = Path(__file__).resolve().parents[2] / "meshes"


# -- in space -------------------------------------------------------------------------------------------------------
SPIN, ROUND = G / 0.2, 1.0  # rad/s: spin about the horizontal axis, and its precession about the vertical


def precession_end(t: float) -> Any:
    """C spin round = m g l holds the axis horizontal: it goes round evenly."""
    return [-np.sin(ROUND * t), np.cos(ROUND * t), 0.0]


SWUNG = ((-1.0, 0.0, 2.0), (0.02, 0.01, 0.02), 1.0)


def governor() -> fmbd.Scene:
    """Stiff flyball governor (IFToMM A05)."""
    spin = np.array([0, 0, 2 * np.pi])
    thin, ball = 0.3, 5.0
    m = thin + ball
    c = (0.5 * thin + ball) / m  # centre of rod and ball from the hinge
    J = np.array([thin * 1e-4 / 6, 0.0, 0.0])
    J[1:] = thin * (1 + 1e-4) / 12 + thin * (c - 0.5) ** 2 + ball * (1 - c) ** 2

    across = np.array([1 + 1e-4, 1 + 1e-4, 2e-4]) * thin / 12
    shaft = fmbd.RigidBody("shaft", thin, across, (0, 0, 0.5), angular_velocity=spin)
    slider = fmbd.RigidBody("slider", 3.0, np.full(3, 0.005), (0, 0, 0.5), angular_velocity=spin)
    scene = fmbd.Scene("flyball governor", gravity=(0, 0, -G))
    guide = fmbd.prismatic("guide", shaft, slider, axis=(0, 0, 1), center=(0, 0, 0.5))
    scene.add(shaft, slider, fmbd.revolute("bearing", fmbd.ground, shaft, center=(0, 0, 0)), guide)

    for name, side in (("right", 1.0), ("left", -1.0)):
        d = np.array([side * np.cos(np.pi / 6), 0, -np.sin(np.pi / 6)])
        hinge, e = np.array([0.05 * side, 0, 1.0]), np.array([0, 1.0, 0])
        R, x = np.stack((d, e, np.cross(d, e)), axis=1), hinge + c * d
        rod = fmbd.RigidBody(name, m, J, x, R, velocity=np.cross(spin, x), angular_velocity=R.T @ spin)
        scene.add(rod, fmbd.revolute(f"hinge {name}", shaft, rod, center=hinge, axis=e))
        ends = (hinge + 0.5 * d, (0.05 * side, 0, 0.5))
        scene.add(fmbd.Spring(f"spring {name}", rod, slider, *ends, stiffness=8e5, damping=4e4, length=0.5))
    scene.sensor("height", fmbd.position(slider))
    return scene


@cache
def governor_end(t_end: float) -> Any:
    """By the angle of the rods and the height of the slider, the spin eliminated by its momentum; Radau of SciPy, 1e-11."""
    thin, ball, slider, c = 0.3, 5.0, 3.0, 5.15 / 5.3
    m, axial = thin + ball, thin * 1e-4 / 6
    across = thin * (1 + 1e-4) / 12 + thin * (c - 0.5) ** 2 + ball * (1 - c) ** 2

    def inertia(a: float) -> float:
        rods = m * (0.05 + c * np.cos(a)) ** 2 + across * np.cos(a) ** 2 + axial * np.sin(a) ** 2
        return float(axial + 0.005 + 2 * rods)

    momentum = inertia(np.pi / 6) * 2 * np.pi

    def rate(t: float, y: Any) -> Any:
        a, s, av, sv = y
        d = np.array([0.5 * np.cos(a), 1 - 0.5 * np.sin(a) - s])
        length = np.sqrt(d @ d)
        da, ds = d @ [-0.5 * np.sin(a), -0.5 * np.cos(a)] / length, -d[1] / length
        tension = 2 * (8e5 * (length - 0.5) + 4e4 * (da * av + ds * sv))
        slope = 2 * (-2 * m * (0.05 + c * np.cos(a)) * c * np.sin(a) + (axial - across) * np.sin(2 * a))
        force = 0.5 * (momentum / inertia(a)) ** 2 * slope + 2 * m * G * c * np.cos(a) - tension * da
        return [av, sv, force / (2 * (across + m * c * c)), -G - tension * ds / slider]

    found = solve_ivp(rate, (0, t_end), [np.pi / 6, 0.5, 0.0, 0.0], method="Radau", rtol=1e-11, atol=1e-13)
    return [0.0, 0.0, float(found.y[1, -1])]


# -- bars, beams, rods ----------------------------------------------------------------------------------------------
def bar_mesh(counts: tuple[int, int], size: tuple[float, float] = (1.0, 0.1), left: float = 0.0) -> Any:
    """Triangles of a bar along x."""
    return fmbd.read_gmsh(MESHES / "block.py", size=size, counts=counts, origin=(left, 0.0))


def pulled(law: Any, reduced: int = 0) -> fmbd.Scene:
    """A bar of 1 m, unit mass per length and wave speed, held at its left, pulled by a law at its right; 16 quadratic cells.

    ``reduced``: by so many modes of vibration.
    """
    scene = fmbd.Scene("pulled bar")
    elastic = fmbd.materials.linear_elastic(10.0, 0.0)
    if reduced:
        body: Any = fmbd.FloatingBody("bar", bar_mesh((16, 1)), density=10.0, elastic=elastic).reduced(modes=reduced)
        held: Any = fmbd.fixed("wall", fmbd.ground, body.surface("left"))
    else:
        body = fmbd.AbsoluteBody("bar", bar_mesh((16, 1)), density=10.0, elastic=elastic)
        held = fmbd.tie_surface("wall", body.surface("left"), fmbd.ground)
    scene.add(body, held, fmbd.force("pull", body.surface("right"), lambda t: (law(t), 0.0)))
    scene.sensor("place", fmbd.position(body.surface("right")))
    return scene


def sudden(t: float) -> float:
    """0.01 N from the start on."""
    return 0.01


def smooth(t: float) -> float:
    """A push that comes and goes within 2 s."""
    return 0.01 * float(np.sin(0.5 * np.pi * t) ** 4) if t < 2.0 else 0.0


def end_of_bar(t: float) -> float:
    """du/dt at the pulled end is the force now less twice that of the wave which has been at the wall, and so on."""
    total = quad(smooth, 0.0, min(t, 2.0), epsabs=1e-16)[0]
    n, sign = 1, -1.0
    while t - 2.0 * n > 0:
        total += 2.0 * sign * quad(smooth, 0.0, min(t - 2.0 * n, 2.0), epsabs=1e-16)[0]
        n, sign = n + 1, -sign
    return float(total)


def standing_wave(pieces: int = 1) -> fmbd.Scene:
    """A bar of 1 m, fixed at its left, in its first longitudinal vibration; of one piece or of two that are tied."""
    scene, last = fmbd.Scene("standing wave"), fmbd.ground
    for k in range(pieces):
        # the cells of the pieces do not match
        mesh = bar_mesh((16 // pieces, 1 + k), (1.0 / pieces, 0.1), k / pieces)
        bar = fmbd.AbsoluteBody(
            f"bar {k}", mesh, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.0),
            displacement=lambda x: np.stack((0.01 * np.sin(0.5 * np.pi * x[0]), 0 * x[0])),
        )  # fmt: skip
        scene.add(bar, fmbd.tie_surface(f"tie {k}", bar.surface("left"), last))
        last = bar.surface("right")
    scene.sensor("place", fmbd.position(last))
    return scene


def stretched_rod() -> fmbd.Scene:
    """The pulled bar as a geometrically exact rod of 6 cubic elements."""
    section = fmbd.RodSection((1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 1.0, (0.1, 0.1, 0.1))
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=6)
    scene = fmbd.Scene("stretched rod")
    scene.add(rod, fmbd.fixed("wall", fmbd.ground, rod.surface("start")))
    scene.add(fmbd.force("pull", rod.surface("end"), lambda t: (smooth(t), 0.0, 0.0)))
    scene.sensor("place", fmbd.position(rod.surface("end")))
    return scene


ROOTS = np.array([1.875104068711961, 4.694091132974175, 7.854757438237613, 10.995540734875467, 14.13716839104647])
BEAM_END, LOAD = 2.0, 1e-4  # s, N


def bent_beam() -> fmbd.Scene:
    """A cantilever of Euler and Bernoulli, unit stiffness, mass and length, a load that comes and goes at its end."""
    section = fmbd.Section(EA=1e4, EI=1.0, rhoA=1.0)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, elements=6)
    scene = fmbd.Scene("bent beam")
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.force("load", beam.surface("end"), lambda t: (0.0, LOAD * 100 * smooth(t))))
    scene.sensor("tip", fmbd.position(beam.surface("end")))
    return scene


@cache
def beam_end(t: float) -> Any:
    """Sum of modes, each of unit mass and 2 at the tip, by Duhamel's integral; of the rest the static deflection."""
    force = lambda s: LOAD * 100 * smooth(s)  # noqa: E731
    omega = ROOTS**2
    w = force(t) * (1 / 3 - float(np.sum(4 / omega**2)))
    for k in omega:
        w += 4 / k * quad(lambda s, k=k: force(s) * np.sin(k * (t - s)), 0, t, epsabs=1e-16, limit=1000)[0]
    return [np.nan, w]


# -- impacts --------------------------------------------------------------------------------------------------------
def bouncing_ball() -> fmbd.Scene:
    """A ball of 0.1 m falls by 1 m on a floor; half its speed is left."""
    body = fmbd.RigidBody("ball", 1.0, 0.004, (0.0, 1.1))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    scene = fmbd.Scene("bouncing ball", gravity=(0.0, -G))
    scene.add(body, fmbd.contact("floor", fmbd.ball(body, 0.1), floor, restitution=0.5))
    scene.sensor("place", fmbd.position(body))
    return scene


FALL = np.sqrt(2.0 / G)  # s


def ball_end(t: float) -> Any:
    """After the first impact, before the second."""
    since = t - FALL
    return [0.0, 0.1 + 0.5 * G * FALL * since - 0.5 * G * since**2]


def bouncing_bar() -> fmbd.Scene:
    """An elastic bar of 10 m falls by 5 m, stays for 2/3 s and leaves with waves in it; 30 cells."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 10.0), counts=(1, 30), origin=(0.0, 5.0), quads=True)
    elastic = fmbd.materials.linear_elastic(900.0, 0.0)
    bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=1.0, elastic=elastic)
    floor = fmbd.Obstacle("ground", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    scene = fmbd.Scene("bouncing bar", gravity=(0.0, -10.0))
    scene.add(bar, fmbd.contact("floor", bar.surface("bottom"), floor))
    scene.sensor("bottom", fmbd.position(bar.surface("bottom")))
    return scene


def sliding_block() -> fmbd.Scene:
    """A block of 1 kg slides with 2 m/s and friction 0.3 until it stops."""
    block = fmbd.RigidBody("block", 1.0, 0.1, (0.0, 0.05), velocity=(2.0, 0.0))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    scene = fmbd.Scene("sliding block", gravity=(0.0, -G))
    points = fmbd.corners(block, [(-0.2, -0.05), (0.2, -0.05)])
    scene.add(block, fmbd.contact("floor", points, floor, friction=0.3))
    scene.sensor("place", fmbd.position(block))
    return scene


EULER, WAVES = "Euler's equations", "exact (d'Alembert)"
FIELDS: dict[str, Problem] = {
    "steady precession": Problem(
        lambda: top((0.0, SPIN, ROUND), (0.1, 0.2, 0.1), 1.0, held=True), 1.0, "place", lambda: precession_end(1.0),
        "exact", 200, "steady precession",
    ),
    "spherical pendulum": Problem(
        lambda: top(*SWUNG, held=True), 1.0, "place", lambda: top_end(*SWUNG, 1.0, held=True), EULER, 100,
        "spherical pendulum",
    ),
    "flyball governor": Problem(
        governor, 1.0, "height", lambda: governor_end(1.0), "three coordinates, Radau of SciPy (IFToMM A05)", 500
    ),
    "standing wave": Problem(standing_wave, 2.0, "place", lambda: [1.0 + 0.01 * np.cos(np.pi), 0.05], "exact"),
    "wave through a tie": Problem(
        lambda: standing_wave(2), 2.0, "place", lambda: [1.0 + 0.01 * np.cos(np.pi), 0.05], "exact"
    ),
    "suddenly pulled bar": Problem(lambda: pulled(sudden), 1.5, "place", lambda: [1.015, 0.05], WAVES),
    "smoothly pulled bar": Problem(lambda: pulled(smooth), 2.5, "place", lambda: [1.0 + end_of_bar(2.5), 0.05], WAVES),
    "pulled bar, reduced": Problem(
        lambda: pulled(smooth, 24), 2.5, "place", lambda: [1.0 + end_of_bar(2.5), 0.05], WAVES
    ),
    "stretched rod": Problem(stretched_rod, 2.5, "place", lambda: [1.0 + end_of_bar(2.5), 0.0, 0.0], WAVES),
    "bent beam": Problem(bent_beam, BEAM_END, "tip", lambda: beam_end(BEAM_END), "exact (modes, Duhamel)", 200),
    "bouncing ball": Problem(bouncing_ball, 0.7, "place", lambda: ball_end(0.7), "exact"),
    "sliding block": Problem(
        sliding_block, 0.8, "place", lambda: [4.0 / (2 * 0.3 * G), 0.05], "exact", 40
    ),
    "bouncing bar": Problem(
        bouncing_bar, 2.0, "bottom", lambda: [0.5, 5.0 / 3.0], "exact (Doyen, Ern, Piperno, doi:10.1137/100791440)", 240
    ),
}  # fmt: skip
