"""Frequencies of rotating arms, with and without a mass at the end, and buckling: the stress of inertia, joints and loads.

References: the inextensible Euler-Bernoulli arm by a Ritz solution, and Euler's loads. A solid differs from them by shear, rotary
inertia, stretch and the Coriolis forces of the stretch, all of the order (height / length)^2; the arms here are 1 : 200.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl
from numpy.polynomial import Legendre, Polynomial

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic, plane_stress
from fmbd_fenicsx.mechanics.placements import Attached, FrameMotion
from fmbd_fenicsx.mechanics.reduction.reduced import ReducedConstants, ReducedPart
from fmbd_fenicsx.system.system import System

ROOT = Path(__file__).resolve().parents[1]
MODULUS, DENSITY = 1e9, 1000.0
FLAP = (3.516, 3.6816, 4.1373, 4.7973, 5.585, 6.4495, 7.3604, 8.2996, 9.2568, 10.2257, 11.2023, 12.1843, 13.1702)
FLAP_2 = (
    22.0345, 22.181, 22.6149, 23.3203, 24.2733, 25.4461, 26.8091, 28.3341, 29.9954, 31.7705, 33.6404, 35.589, 37.6031
)  # fmt: skip
LAG = (3.516, 3.5432, 3.6218, 3.7435, 3.8977, 4.0739, 4.2632, 4.4591, 4.6571, 4.8543, 5.049, 5.24, 5.427)
THIN = 0.01  # m, of columns: shear takes pi^2 E / (12 G k) (height / length)^2 = 3e-4 off Euler's load
QUIET = fmbd.Output(estimate_error=False)


def arm(dim: int, height: float, cells: int, **changes: Any) -> fmbd.FloatingBody:
    """A square or flat arm of length 1 m along x in cubic cells, held at "left"."""
    size = (1.0, *(height,) * (dim - 1))
    mesh = fmbd.read_gmsh(
        ROOT / "meshes/block.py",
        size=size,
        origin=(0.0, *(-height / 2,) * (dim - 1)),
        counts=(cells, *(1,) * (dim - 1)),
        quads=True,
    )
    elastic = plane_stress(MODULUS, 0.3) if dim == 2 else linear_elastic(MODULUS, 0.3)
    body = fmbd.FloatingBody(
        "arm", mesh, degree=3, density=DENSITY, elastic=elastic, frame=Attached("left"), stiffening=True
    )
    return body.with_(**changes)


def unit(height: float) -> float:
    """sqrt(EI / rhoA) / L^2, rad/s."""
    return float(np.sqrt(MODULUS * height**2 / 12 / DENSITY))


def derivative(f: Callable[[Any], Any], steps: Any) -> Any:
    """Columns of central differences of f about zero."""
    return np.array([(f(s) - f(-s)) / (2 * np.abs(s).max()) for s in np.diag(steps)]).T


def oscillations(K: Any, C: Any, M: Any) -> Any:
    """Imaginary parts of the eigenvalues of M z'' + C z' + K z = 0, ascending; all are undamped."""
    n = len(K)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    values = np.linalg.eigvals(A)
    assert np.abs(values.real).max() < 1e-9 * np.abs(values).max()
    return np.sort(values.imag[values.imag > 0])


def nearest(found: Any, value: float) -> float:
    """The frequency closest to a reference."""
    return float(found[np.argmin(np.abs(found - value))])


def spinning(c: ReducedConstants, rate: float) -> Any:
    """Frequencies (rad/s) about steady rotation about the root, Coriolis forces included."""
    d = c.S.shape[0]
    part, zero = ReducedPart("arm", c, 0, []), np.zeros(c.n_modes)
    twist, accel = np.zeros((2, 3 if d == 2 else 6))
    twist[1], twist[-1], accel[0] = 0.5 * rate, rate, -0.5 * rate**2  # the frame's origin is the middle
    motion = FrameMotion(0.0, np.eye(d), twist, accel, np.zeros(d))

    def rows(which: int) -> Callable[[Any], Any]:
        return lambda x: part.force(motion, (*(zero,) * which, x, *(zero,) * (2 - which)))[1]

    return oscillations(*(derivative(rows(k), np.full(c.n_modes, 1e-6)) for k in range(3)))


def compare(c: ReducedConstants, height: float) -> None:
    """Every frequency of the table to 1e-3."""
    for gamma, flap, flap_2, lag in zip(range(13), FLAP, FLAP_2, LAG, strict=True):
        found = spinning(c, gamma * unit(height)) / unit(height)
        wanted = [lag, float(np.sqrt(flap_2**2 - gamma**2))]
        wanted += [flap, flap_2] if c.S.shape[0] == 3 else []
        for reference in wanted:
            np.testing.assert_allclose(nearest(found, reference), reference, rtol=1e-3)


def test_rotating_cantilever() -> None:
    """Lag, first and second, for gamma = 0 ... 12."""
    compare(arm(2, 0.005, 20).reduced(modes=10).constants, 0.005)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_rotating_cantilever_in_space() -> None:
    """Flap and lag, first and second, of a square arm in hexahedra."""
    compare(arm(3, 0.005, 16).reduced(modes=14).constants, 0.005)


def test_what_separates_the_solid_from_the_table_is_its_thickness() -> None:
    """At gamma = 10 the lag frequency of a solid is off by 14 (height / length)^2 / 0.4: four times less at half the height."""
    off = []
    for height in (0.04, 0.02):
        c = arm(2, height, 16).reduced(modes=10).constants
        off.append(1.0 - spinning(c, 10 * unit(height))[0] / unit(height) / LAG[10])
    assert off[1] > 2e-3
    np.testing.assert_allclose(off[0] / off[1], 4.0, rtol=0.1)


def ritz(gamma: float, mass: float) -> Any:
    """Lag frequencies, in units, of an arm with the given share of its mass at the end."""
    x, w = np.polynomial.legendre.leggauss(60)
    x, w = 0.5 * (x + 1), 0.5 * w
    base = [Polynomial([0, 0, 1]) * Legendre.basis(k, domain=[0, 1]).convert(kind=Polynomial) for k in range(14)]
    v, slope, bend = (np.array([p.deriv(k)(x) if k else p(x) for p in base]) for k in range(3))
    end = np.array([p(1.0) for p in base])
    M = (v * w) @ v.T + mass * np.outer(end, end)
    tension = gamma**2 * (0.5 * (1 - x**2) + mass)
    return np.sqrt(sl.eigh((bend * w) @ bend.T + (slope * w * tension) @ slope.T - gamma**2 * M, M)[0][:2])


def turning(system: System, start: Any, rate: float) -> Any:
    """Frequencies (rad/s) about the relative equilibrium of a planar system that turns about the origin.

    With z in turning axes places move by z, velocities by z' + w x z, accelerations by z'' + 2 w x z' + w x (w x z).
    """
    n, S = system.n_v, np.array([[0.0, -rate], [rate, 0.0]])
    W, A1, A0 = np.zeros((3, n, n))
    v0, o, lam = np.zeros(n), np.zeros(n), np.zeros(system.n_lam)
    for k in range(system.n_frames):
        at = slice(3 * k, 3 * k + 2)
        W[at, at], A1[at, at], A0[at, at] = S, 2 * S, S @ S
        v0[at], v0[3 * k + 2] = S @ start.q[at], rate
    a0 = A0 @ np.concatenate((start.q[: 3 * system.n_frames], np.zeros(n - 3 * system.n_frames)))
    steps = 1e-6 / system.units

    def rows(z: Any, zd: Any, zdd: Any) -> Any:
        ev = system.at(0.0, system.compose(start.q, z), v0 + zd + W @ z)
        return ev.balance(a0 + zdd + A1 @ zd + A0 @ z, lam)

    z = o
    for _ in range(4):
        ev = system.at(0.0, system.compose(start.q, z), v0)
        G = np.array([ev.jacobian.times(e) for e in np.eye(n)]).T
        K = derivative(lambda x, z=z: rows(z + x, o, o), steps)
        big = np.block([[K, G.T], [G, np.zeros((len(G), len(G)))]])
        s = np.linalg.solve(big, -np.concatenate((rows(z, o, o), ev.constraint())))
        z, lam = z + s[:n], lam + s[n:]
    assert np.abs(rows(z, o, o)).max() <= 1e-6 * max(np.abs(lam).max(), 1e-12)
    Z = sl.null_space(G)
    forms = (lambda x: rows(z + x, o, o), lambda x: rows(z, x, o), lambda x: rows(z, o, x))
    return oscillations(*(Z.T @ derivative(f, steps) @ Z for f in forms))


def with_tip_mass(body: Any, root: str, tip: str, mass: float, rate: float) -> fmbd.Scene:
    """The arm on a driven hub, with a point mass (kg) at its end."""
    scene = fmbd.Scene("arm")
    hub = fmbd.RigidBody("hub", mass=1.0, inertia=1.0, position=(0.0, 0.0))
    end = fmbd.RigidBody("mass", mass=mass, inertia=1e-12, position=(1.0, 0.0))
    scene.add(body, hub, end, fmbd.fixed("weld", hub, body.surface(root)))
    scene.add(fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0)))
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, hub, lambda t: (rate * t, rate, 0.0)))
    scene.add(fmbd.fixed("head", end, body.surface(tip)))
    return scene


def section(height: float) -> fmbd.Section:
    return fmbd.Section.rectangle(youngs_modulus=MODULUS, poisson_ratio=0.3, density=DENSITY, width=1.0, height=height)


@pytest.mark.parametrize("kind", ["beam", "solid"])
def test_mass_at_the_end_of_a_rotating_arm(kind: str) -> None:
    """The reaction of the joint stiffens: lag frequencies to 1e-3 with the mass of the arm at its end."""
    h = 0.005
    rhoA = DENSITY * h
    if kind == "beam":
        body: Any = fmbd.Beam("arm", (0, 0), (1, 0), section(h), elements=12, stiffening=True)
        surfaces = ("start", "end")
    else:
        body, surfaces = arm(2, h, 20).reduced(modes=20), ("left", "right")
    for gamma in (0, 3, 5, 8):
        system, start, _ = with_tip_mass(body, *surfaces, rhoA, gamma * unit(h)).build()
        found = turning(system, start, gamma * unit(h)) / unit(h)
        for reference in ritz(gamma, 1.0):
            np.testing.assert_allclose(nearest(found, reference), reference, rtol=1e-3)


def column(body: Any, ends: tuple[str, str], load: float, pinned: bool) -> fmbd.Scene:
    """A column under a dead load (N) along it: clamped and free, or pinned to the ground and to a guided slider."""
    scene = fmbd.Scene("column", settle=True)
    root, head = (body.surface(e) for e in ends)
    scene.add(body)
    if not pinned:
        scene.add(fmbd.fixed("clamp", fmbd.ground, root), fmbd.force("load", head, lambda t: (-load, 0.0)))
        return scene
    slider = fmbd.RigidBody("slider", mass=0.01, inertia=1.0, position=(1.0, 0.0))
    scene.add(slider, fmbd.revolute("pin", fmbd.ground, root, center=(0, 0)))
    scene.add(fmbd.revolute("head", slider, head, center=(1, 0)))
    scene.add(fmbd.prismatic("guide", fmbd.ground, slider, center=(1, 0), axis=(1, 0)))
    scene.add(fmbd.force("load", slider, lambda t: (-load, 0.0)))
    return scene


def softest(scene: fmbd.Scene) -> float:
    """Smallest eigenvalue of the tangent at equilibrium on the motions that the joints leave."""
    run = fmbd.solve(scene, t_end=1e-6, dt=1e-6, output=QUIET)
    system, state, _ = scene.build()
    state, o = run.state, np.zeros(system.n_v)
    steps = 1e-6 / system.units

    def rows(x: Any, a: Any) -> Any:
        return system.at(0.0, system.compose(state.q, x), o).balance(a, state.lam)

    ev = system.at(0.0, state.q, o)
    Z = sl.null_space(np.array([ev.jacobian.times(e) for e in np.eye(system.n_v)]).T)
    K, M = (Z.T @ derivative(f, steps) @ Z for f in (lambda x: rows(x, o), lambda a: rows(o, a)))
    assert np.abs(K - K.T).max() < 1e-6 * np.abs(K).max()  # forces of joints and dead loads have a potential
    return float(sl.eigh(0.5 * (K + K.T), 0.5 * (M + M.T), eigvals_only=True)[0])


def solid_column(frame: Any, stiffening: bool | str, **changes: Any) -> Any:
    body = arm(2, THIN, 12, frame=frame, stiffening=stiffening, **changes)
    return body.reduced(basis=fmbd.CraigBampton(("left", "right"), 6))


CLAMPED, PINNED = ("beam", "attached", "load"), ("beam, mean axes", "chord", "mean axes")


@pytest.mark.parametrize("case", [*CLAMPED, *PINNED])
def test_buckling(case: str) -> None:
    """Euler's load to 1e-3, the load on a joint, a surface or as a traction, whatever the frame and wherever it is held."""
    pinned = case in PINNED
    euler = np.pi**2 * MODULUS * THIN**3 / 12 * (1.0 if pinned else 0.25)

    def made(load: float) -> fmbd.Scene:
        ends = ("left", "right")
        if case.startswith("beam"):
            ends = ("start", "end")
            body: Any = fmbd.Beam(
                "arm", (0, 0), (1, 0), section(THIN), elements=8, stiffening=True, attached=case == "beam"
            )
        elif case == "load":
            push = fmbd.traction("right", (-load / THIN, 0.0))
            return column(solid_column(Attached("left"), True, loads=[push]), ends, 0.0, pinned)
        else:
            frames = {"attached": Attached("left"), "chord": fmbd.Chord("left", "right"), "mean axes": fmbd.MeanAxis()}
            body = solid_column(frames[case], "right" if case == "mean axes" else "left")
        return column(body, ends, load, pinned)

    low, high = (softest(made(share * euler)) for share in (0.97, 0.99))
    critical = 0.99 + 0.02 * high / (low - high)
    np.testing.assert_allclose(critical, 1.0, rtol=1e-3)
