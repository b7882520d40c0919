"""Beams in a floating frame: frequencies, static deflection, inertia, rotation with and without stiffening."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.bodies.beam_elements import constants_of
from fmbd_fenicsx.mechanics.placements import FrameMotion
from fmbd_fenicsx.mechanics.reduction.reduced import ReducedPart
from fmbd_fenicsx.system import axial_forces
from fmbd_fenicsx.system.spins import held_mode
from fmbd_fenicsx.system.tangents.jacobian import CorePattern

L, EI, RHO_A = 1.0, 1.0, 1.0
# torsion far above bending, but not so far that the roundoff of its eigenvalues, eps GJ / rhoI (pi n / L)^2, is seen in theirs
SLENDER = fmbd.Section(EA=1e8, EI=EI, rhoA=RHO_A, EI_y=EI, GJ=1.0, rhoI=1e-9, rhoI_y=1e-9)
FREE_FREE = (22.3733, 61.6728, 120.9034)
CLAMPED = (3.51602, 22.0345, 61.6972)
# frequencies of a rotating cantilever without hub, times sqrt(rhoA L^4 / EI), for these rates of rotation; Wright, Smith,
# Thresher and Wang, Vibration modes of centrifugally stiffened beams, J. Appl. Mech. 49, 1982
ROTATION = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12)
FLAP_1 = (3.5160, 3.6816, 4.1373, 4.7973, 5.5850, 6.4495, 7.3604, 9.2568, 11.2022, 13.1702)
FLAP_2 = (22.0345, 22.1810, 22.6149, 23.3203, 24.2733, 25.4461, 26.8091, 29.9954, 33.6404, 37.6031)


def omega(beam: fmbd.Beam) -> Any:
    c = beam.constants
    return np.sqrt(np.abs(sl.eigh(c.K, np.trace(c.T[1:, 1:], axis1=2, axis2=3), eigvals_only=True)))


@pytest.mark.parametrize("start, end", [((0.0, 0.0), (1.0, 0.0)), ((0.3, 0.1), (0.9, 0.9))])
def test_frequencies_in_the_plane(start: Any, end: Any) -> None:
    """Euler-Bernoulli values, clamped and free-free, in any direction."""
    np.testing.assert_allclose(omega(fmbd.Beam("b", start, end, SLENDER))[:3], CLAMPED, rtol=1e-3)
    np.testing.assert_allclose(omega(fmbd.Beam("b", start, end, SLENDER, attached=False))[:3], FREE_FREE, rtol=1e-3)


def test_frequencies_in_space() -> None:
    """Both bending planes, torsion pi/2 sqrt(GJ / (rho I_p)) / L and stretching, in a skew direction."""
    section = fmbd.Section(EA=1e4, EI=1.0, rhoA=1.0, EI_y=4.0, GJ=0.5, rhoI=1e-3, rhoI_y=1e-3)
    found = omega(fmbd.Beam("b", (0, 0, 0), (2 / 3, 2 / 3, 1 / 3), section, elements=40))
    bend = CLAMPED[0] * np.array([1.0, 2.0])
    for expected in (*bend, np.pi / 2 * np.sqrt(0.5 / 2e-3), np.pi / 2 * np.sqrt(1e4)):
        assert np.abs(found / expected - 1).min() < 5e-3, expected


def test_round_sections_are_those_of_rods() -> None:
    """A tube: E A, E I, G J, shear by Cowper's factor, rho I."""
    tube = dict(youngs_modulus=2e11, poisson_ratio=0.3, density=7800.0, radius=0.03, inner=0.02)
    beam, rod = fmbd.Section.circle(**tube), fmbd.RodSection.circle(**tube)
    assert (beam.EA, beam.GA, beam.GA, beam.GJ, beam.EI_y, beam.EI) == pytest.approx(rod.stiffness)
    assert (beam.rhoA, beam.rhoI, beam.rhoI_y) == pytest.approx((rod.mass, *rod.inertia[1:]))
    assert beam.EI == pytest.approx(2e11 * np.pi * (0.03**4 - 0.02**4) / 4)
    with pytest.raises(InputError, match="inner < radius"):
        fmbd.Section.circle(**tube | {"inner": 0.04})
    with pytest.raises(InputError, match="Section.circle: density"):
        fmbd.Section.circle(**tube | {"density": -1.0})


def test_timoshenko_static_tip() -> None:
    """Tip force: F L^3 / (3 EI) + F L / GA, exact with one element."""
    section = fmbd.Section(EA=1e3, EI=2.0, rhoA=1.0, GA=5.0)
    c = fmbd.Beam("b", (0.0, 0.0), (3.0, 0.0), section, elements=1).constants
    port = c.surfaces["end"].modes
    tip = port[1] @ np.linalg.solve(c.K, port[1])
    np.testing.assert_allclose(tip, 27 / 6 + 3 / 5, rtol=1e-12)


def test_force_beside_its_surface() -> None:
    """As on a rigid arm from the end: f across bends by f L^3 / (3 EI), the moment of a force at (x, y) by M L^2 / (2 EI)."""
    f, x, y = np.array([0.5, 2.0]), 0.4, 0.2
    beam = fmbd.Beam("b", (0.0, 0.0), (L, 0.0), fmbd.Section(EA=1e6, EI=1e3, rhoA=RHO_A), elements=2)
    scene = fmbd.Scene("arm")
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.force("pull", beam.surface("end"), f, point=(x, y)))
    scene.sensor("end", fmbd.position(beam.surface("end")))
    scene.sensor("moment", fmbd.reaction_torque("clamp"))
    found, moment = fmbd.equilibrium(scene), (x - L) * f[1] - y * f[0]
    assert found["end"][1] == pytest.approx(f[1] * L**3 / 3e3 + moment * L**2 / 2e3, rel=2e-3)
    assert abs(float(found["moment"][0])) == pytest.approx(abs(x * f[1] - y * f[0]), rel=2e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_rigid_inertia_and_momentum(dim: int) -> None:
    """A beam without modes is a rod with mass rhoA L and inertia rhoA L^3 / 12 + rhoI L; its sections are where they are."""
    start, end = np.array([1.0, 2.0, 0.5][:dim]), np.array([1.0, 5.0, 4.5][:dim])
    section = fmbd.Section(EA=1.0, EI=1.0, rhoA=2.0, EI_y=1.0, GJ=1.0, rhoI=0.1, rhoI_y=0.2)
    beam = fmbd.Beam("b", start, end, section, modes=0)
    length = np.linalg.norm(end - start)
    part = ReducedPart("b", beam.constants, 0, ["start", "end"])
    M = part.mass_blocks(FrameMotion(0.0, np.eye(dim), np.zeros(3 * dim - 3), None, np.zeros(dim)), np.zeros(0))[0]
    np.testing.assert_allclose(M[:dim, :dim], 2.0 * length * np.eye(dim), rtol=1e-12)
    main = 2.0 * length**3 / 12
    values = np.linalg.eigvalsh(M[dim:, dim:])
    expected = [main + 0.1 * length] if dim == 2 else [0.3 * length, main + 0.1 * length, main + 0.2 * length]
    np.testing.assert_allclose(values, expected, rtol=1e-10)
    np.testing.assert_allclose(beam.constants.surfaces["end"].reference[0] + beam.constants.center, end, atol=1e-12)


def spinning(rate: float, stiffening: bool = True) -> Any:
    """Eigenvalues (squares of frequencies) of small motions about steady rotation about z at the root."""
    beam = fmbd.Beam("b", (0, 0, 0), (1, 0, 0), SLENDER, elements=16, up=(0, 1, 0), stiffening=stiffening)
    part = ReducedPart("b", beam.constants, 0, [])
    twist = np.array([0.0, 0.5 * rate, 0.0, 0.0, 0.0, rate])  # centre of the beam at (1/2, 0, 0)
    accel = np.array([-0.5 * rate**2, 0.0, 0.0, 0.0, 0.0, 0.0])
    motion = FrameMotion(0.0, np.eye(3), twist, accel, np.zeros(3))
    zero = np.zeros(part.n)

    def rows(eta: Any) -> Any:
        return part.force(motion, (eta, zero, zero))[1]

    K = np.array([(rows(1e-4 * e) - rows(-1e-4 * e)) / 2e-4 for e in np.eye(part.n)]).T
    return sl.eigh(0.5 * (K + K.T), np.trace(beam.constants.T[1:, 1:], axis1=2, axis2=3), eigvals_only=True)


@pytest.mark.parametrize("k", range(len(ROTATION)))
def test_rotating_cantilever(k: int) -> None:
    """Flapping and lagging frequencies of a rotating cantilever to 2e-4."""
    found = spinning(ROTATION[k])
    lag = FLAP_1[k] ** 2 - ROTATION[k] ** 2
    for expected in (FLAP_1[k] ** 2, FLAP_2[k] ** 2, lag):
        assert np.abs(np.sqrt(np.abs(found) / expected) - 1).min() < 2e-4


def test_no_stable_solution_without_stiffening() -> None:
    """The lag stiffness 12.362 - gamma^2 is negative above gamma = 3.516."""
    assert spinning(3.4, stiffening=False).min() > 0
    np.testing.assert_allclose(spinning(5.0, stiffening=False).min(), 12.362 - 25.0, rtol=1e-3)


def test_report_of_bad_input() -> None:
    """Sections, ends and modes that cannot be."""
    with pytest.raises(InputError, match="EI"):
        fmbd.Section(EA=1.0, EI=-1.0, rhoA=1.0)
    with pytest.raises(InputError, match="coincide"):
        fmbd.Beam("b", (0.0, 0.0), (0.0, 0.0), SLENDER)
    with pytest.raises(InputError, match="GJ"):
        fmbd.Beam("b", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), fmbd.Section(EA=1.0, EI=1.0, rhoA=1.0))
    with pytest.raises(InputError, match="Known"):
        fmbd.Beam("b", (0.0, 0.0), (1.0, 0.0), SLENDER).surface("tip")
    with pytest.raises(InputError, match="modes asked for"):
        _ = fmbd.Beam("b", (0.0, 0.0), (1.0, 0.0), SLENDER, elements=1, modes=9).constants


@pytest.mark.parametrize("per_element", [1, 3])
def test_the_centre_line_is_drawn_at_even_places(per_element: int) -> None:
    beam = fmbd.Beam("b", (0.0, 0.0), (0.6, 0.8), SLENDER, elements=5)
    x = beam.centre_line(per_element)[:, :, 0]
    assert len(x) == 5 * per_element + 1
    steps = np.diff(x, axis=0)
    assert steps == pytest.approx(np.tile([0.6, 0.8], (len(steps), 1)) / len(steps), abs=1e-12)


def _chain(count: int) -> fmbd.Scene:
    """Beams on hinges, one after the other."""
    scene, last = fmbd.Scene("chain", gravity=(0.0, -9.81)), fmbd.ground
    law = {"youngs_modulus": 2e9, "poisson_ratio": 0.3, "density": 1000.0}
    section = fmbd.Section.rectangle(**law, width=0.02, height=0.02)
    for k in range(count):
        beam = fmbd.Beam(f"{k}", (0.3 * k, 0.0), (0.3 * k + 0.3, 0.0), section, elements=1)
        scene.add(beam, fmbd.revolute(f"pin {k}", last, beam.surface("start"), center=(0.3 * k, 0.0)))
        last = beam.surface("end")
    return scene


def _entered(what: Callable[[], Any]) -> Counter[str]:
    """Which functions written in C it enters, and how often."""
    found: Counter[str] = Counter()
    before = sys.getprofile()
    sys.setprofile(lambda _, event, of: found.update([of.__name__] if event == "c_call" else ()))
    try:
        what()
    finally:
        sys.setprofile(before)
    return found


def test_a_chain_of_many_beams_costs_what_its_beams_cost() -> None:
    """Matrices of all are summed once, not once a beam; nobody asks all joints for how one beam is held."""
    runs, looks = [], []
    for count in (40, 80):
        fmbd.solve(_chain(count), t_end=2e-3, dt=1e-3)  # keeps its structure
        scene = _chain(count)
        runs.append(_entered(lambda scene=scene: fmbd.solve(scene, t_end=2e-3, dt=1e-3)))

        system, state, _ = scene.build()
        ev = system.at(state.t, state.q, state.v)
        held_mode(ev, 0, system.parts[0])
        looks.append(_entered(lambda ev=ev, part=system.parts[1]: held_mode(ev, 1, part)).total())

    few, many = runs
    assert many["csr_plus_csr"] == few["csr_plus_csr"] < 20
    assert many.total() < 2.1 * few.total()
    assert looks[0] == looks[1]


SOLID = {"youngs_modulus": 1e8, "poisson_ratio": 0.3, "density": 1e3, "width": 0.1, "height": 0.05}


def line_of(n: int, dim: int) -> fmbd.Scene:
    """A chain of beams on hinges."""
    scene, last = fmbd.Scene("beams", gravity=(0.0, -9.81, 0.0)[:dim]), fmbd.ground
    for k in range(n):
        ends = [(0.9 * x, 0.0, 0.0)[:dim] for x in (k, k + 1)]
        beam = fmbd.Beam(f"beam {k}", *ends, fmbd.Section.rectangle(**SOLID), elements=3)
        scene.add(beam, fmbd.revolute(f"pin {k}", last, beam.surface("start"), center=ends[0]))
        last = beam.surface("end")
    return scene


@pytest.mark.parametrize(("dim", "most"), [(2, 750), (3, 1100)])
def test_a_further_beam_of_a_chain_costs_few_calls_at_the_start(dim: int, most: int) -> None:
    """Beams are made together; what follows from the constants of all of them, too. As many for each one in long chains."""
    calls = []
    for n in (3, 24, 48, 144):
        scene = line_of(n, dim)
        calls.append(calls_of(lambda scene=scene: fmbd.solve(scene, t_end=1e-3, dt=1e-3)))
    short, long = (calls[2] - calls[1]) / 24, (calls[3] - calls[2]) / 96
    assert short < most
    assert long < 1.03 * short


def test_beams_made_together_are_those_made_alone() -> None:
    """Of several forms, lengths, directions and sections, in any order."""
    rng, beams = np.random.default_rng(5), []
    for k in range(40):
        dim, form = 2 + k % 2, k % 5
        section = fmbd.Section.rectangle(**SOLID | {"height": float(rng.uniform(0.03, 0.06))})
        more: dict[str, Any] = {"elements": 2 + form, "attached": form != 1, "stiffening": form == 2}
        more |= {"modes": 3} if form == 3 else {}
        ends = rng.standard_normal((2, dim))
        beams.append(fmbd.Beam(f"beam {k}", *ends, section, mass_damping=0.1 * k, stiffness_damping=1e-3, **more))

    for beam, together in zip(beams, constants_of(beams), strict=True):
        alone = beam.constants
        assert together.mass == alone.mass and together.size == alone.size
        np.testing.assert_allclose(together.center, alone.center, rtol=1e-15)
        for name in ("S", "T", "K", "D") + (("stiffening",) if beam.stiffening else ()):
            x, y = getattr(together, name), getattr(alone, name)
            np.testing.assert_allclose(x, y, rtol=0.0, atol=1e-12 * np.abs(y).max() + 1e-12 * (name == "S"))
        for end, surface in alone.surfaces.items():
            y = surface.modes
            np.testing.assert_allclose(together.surfaces[end].modes, y, rtol=0.0, atol=1e-12 * np.abs(y).max() + 1e-15)
        np.testing.assert_allclose(together.derived.first_frequency, alone.derived.first_frequency, rtol=1e-10)


def test_looks_at_what_presses_beams_make_no_rows_of_coordinates(monkeypatch: Any) -> None:
    """Forces on surfaces follow from the rows on ports alone: of 80 beams those of coordinates cost more than the look."""
    made: list[Any] = []
    core = CorePattern.core
    monkeypatch.setattr(CorePattern, "core", lambda pattern, entries: made.append(1) or core(pattern, entries))
    looks: list[Any] = []
    look = axial_forces.surface_forces
    monkeypatch.setattr(axial_forces, "surface_forces", lambda ev, lam: looks.append(1) or look(ev, lam))

    section = fmbd.Section.rectangle(youngs_modulus=1e8, poisson_ratio=0.3, density=1e3, width=0.1, height=0.05)
    scene, last = fmbd.Scene("chain", gravity=(0.0, -9.81, 0.0)), fmbd.ground
    for k in range(80):
        beam = fmbd.Beam(f"b{k}", (k, 0.0, 0.0), (k + 1.0, 0.0, 0.0), section, elements=2)
        pin = fmbd.revolute(f"p{k}", last, beam.surface("start"), center=(k, 0.0, 0.0), axis=(0.0, 0.2, 1.0))
        scene.add(beam, pin)
        last = beam.surface("end")
    fmbd.solve(scene, t_end=1e-3, dt=1e-3)
    assert looks and not made
