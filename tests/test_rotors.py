"""Rotors that spin while their support rests: equilibria, modes, Campbell's diagrams."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import eig

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.rotations import Array

MASS, J, ACROSS = 12.0, 0.4, 0.25  # of a disc: inertia about its axis and across
KY, KZ, LEVER = 4e4, 9e4, 0.3  # springs of its bearings, at +- LEVER along the axis


def disc_in_springs(inertia: tuple[float, float, float] = (J, ACROSS, ACROSS), **more: Any) -> fmbd.Scene:
    """A disc about x in two bearings that are softer along y than along z, under weight."""
    disc = fmbd.RigidBody("disc", MASS, inertia)
    scene = fmbd.Scene("rotor", gravity=(0.0, 0.0, -9.81))
    scene.add(disc)
    for side in (-LEVER, LEVER):
        end = (side, 0.0, 0.0)
        K = np.diag([1e6 / 2, KY, KZ, 0.0, 0.0, 0.0])
        scene.add(fmbd.bushing(f"bearing {side:g}", fmbd.ground, disc, center=end, stiffness=K))
    scene.sensor("disc", fmbd.position(disc))
    return scene


def exact(speed: float) -> Array:
    """Frequencies (rad/s) of the disc: two plain vibrations and two tilts coupled by the spin."""
    tilt_y, tilt_z = 2.0 * LEVER**2 * KZ, 2.0 * LEVER**2 * KY
    none, M, K = np.zeros((2, 2)), np.diag([ACROSS, ACROSS]), np.diag([tilt_y, tilt_z])
    G = J * speed * np.array([[0.0, 1.0], [-1.0, 0.0]])
    A = np.block([[none, np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, G)]])
    tilts = eig(A, right=False).imag
    plain = np.sqrt(np.array([2 * KY, 2 * KZ, 1e6]) / MASS)
    return np.sort(np.concatenate((plain, tilts[tilts > 0])))


@pytest.mark.parametrize("speed", [0.0, 60.0, 400.0])
def test_disc_in_unequal_bearings(speed: float) -> None:
    """Forward and backward tilts part as the disc spins faster; the bearings rest, and sag under its weight."""
    scene = disc_in_springs()
    found = fmbd.equilibrium(scene, spin=fmbd.Spin(speed, (1.0, 0.0, 0.0), bodies=("disc",)))
    assert found["disc"][2] == pytest.approx(-MASS * 9.81 / (2.0 * KZ), rel=1e-9)
    assert found.state.v[3] == pytest.approx(speed)
    omega = np.sort(fmbd.modes(scene, 6 if speed == 0.0 else 7, at=found).omega)
    assert omega[-5:] == pytest.approx(exact(speed), rel=1e-7)
    assert omega[:-5].max() < 1e-6  # the angle of the disc is free


def shaft(elements: int, spins: bool, width: float = 0.02) -> fmbd.Scene:
    """A shaft in two hinges with a disc off the middle; with ``spins`` hinges about the shaft, else none that turn."""
    section = fmbd.RodSection.circle(youngs_modulus=2e11, poisson_ratio=0.3, density=7800.0, radius=0.01)
    if width != 0.02:
        section = fmbd.RodSection.rectangle(
            youngs_modulus=2e11, poisson_ratio=0.3, density=7800.0, width=width, height=0.02
        )
    rod = fmbd.Rod("shaft", [(0, 0, 0), (1, 0, 0)], section, elements=elements, stations={"seat": 0.3})
    disc = fmbd.RigidBody("disc", 5.0, (0.03, 0.016, 0.016), position=(0.3, 0.0, 0.0))
    scene = fmbd.Scene("shaft", gravity=(0.0, 0.0, -9.81) if spins else (0.0, 0.0, 0.0))
    scene.add(rod, disc, fmbd.fixed("press", rod.surface("seat"), disc, center=(0.3, 0, 0)))
    if spins:
        front = fmbd.revolute("front", fmbd.ground, rod.surface("start"), axis=(1, 0, 0), center=(0, 0, 0))
        scene.add(front, fmbd.cylindrical("back", fmbd.ground, rod.surface("end"), axis=(1, 0, 0), center=(1, 0, 0)))
    else:
        scene.add(fmbd.fixed("front", fmbd.ground, rod.surface("start")))
        scene.add(fmbd.prismatic("back", fmbd.ground, rod.surface("end"), axis=(1, 0, 0)))
    scene.sensor("disc", fmbd.position(disc))
    return scene


def test_axes_at_rest_and_axes_that_turn() -> None:
    """Both tell the same whirl of a round shaft; with weight as well, which only axes at rest know."""
    spins = fmbd.campbell(
        lambda _: shaft(3, True), [0.0, 150.0], 5, spin=fmbd.Spin(0.0, (1, 0, 0), bodies=("shaft", "disc"))
    )
    turns = fmbd.campbell(lambda _: shaft(3, False), [0.0, 150.0], 4, spin=fmbd.Spin(0.0, (1, 0, 0)))
    seen, known = (np.sort(np.abs(x.fixed[1]))[:5] for x in (spins, turns))
    for frequency in known[:2]:
        assert np.abs(seen - frequency).min() < 2e-4 * frequency
    assert known[1] - known[0] > 1.0


def test_what_is_not_steady_is_refused() -> None:
    spin = fmbd.Spin(50.0, (1.0, 0.0, 0.0), bodies=("disc",))
    oval = disc_in_springs((J, ACROSS, 0.7 * ACROSS))
    with pytest.raises(InputError, match='mass of "disc" changes as they turn'):
        fmbd.modes(oval, 1, at=fmbd.equilibrium(oval, spin=spin))
    with pytest.raises(InputError, match='"dsic", which is no rigid body.*"disc"'):
        fmbd.equilibrium(disc_in_springs(), spin=fmbd.Spin(1.0, bodies=("dsic",)))
    with pytest.raises(InputError, match='"press" does not let "disc" spin'):
        fmbd.equilibrium(shaft(2, True), spin=spin)
    with pytest.raises(InputError, match='rotation of "shaft", "disc" is not steady'):
        fmbd.equilibrium(shaft(2, True, 0.01), spin=fmbd.Spin(50.0, (1.0, 0.0, 0.0), bodies=("shaft", "disc")))


def test_a_drive_turns_with_the_rotor() -> None:
    """A motor of its speed is right, any other is refused."""
    for rate in (50.0, 20.0):
        body = fmbd.RigidBody("rotor", 1.0, 0.1)
        hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0.0, 0.0))
        scene = fmbd.Scene("motor", gravity=(0.0, -9.81))
        scene.add(body, hinge, fmbd.drive("motor", fmbd.angle(hinge), lambda t, rate=rate: rate * t))
        scene.sensor("force", fmbd.sensors.reaction_force("hinge"))
        spin = fmbd.Spin(50.0, bodies=("rotor",))
        if rate == 50.0:
            assert abs(fmbd.equilibrium(scene, spin=spin)["force"][1]) == pytest.approx(9.81, rel=1e-9)
            continue
        with pytest.raises(InputError, match='"motor" does not let "rotor" spin'):
            fmbd.equilibrium(scene, spin=spin)


def test_the_free_turn_of_a_rotor_is_no_mode_of_its_diagram() -> None:
    """A shaft with a disc in round bearings: roundoff of its free turn made two modes of zero at some speeds and one at others,
    and a critical speed where it was counted otherwise.
    """

    def make(speed: float) -> fmbd.Scene:
        section = fmbd.RodSection.circle(youngs_modulus=2.1e11, poisson_ratio=0.3, density=7800, radius=0.006)
        rod = fmbd.Rod("shaft", [(0, 0, 0), (0.6, 0, 0)], section, elements=3, damping=1e-5, stations={"disc": 0.2})
        disc = fmbd.RigidBody("disc", 2.0, (6.4e-3, 3.2e-3, 3.2e-3), position=(0.2, 0, 0))
        scene = fmbd.Scene("rotor")
        scene.add(rod, disc, fmbd.fixed("shrink", rod.surface("disc"), disc, center=(0.2, 0, 0)))
        for name in ("start", "end"):
            k = (5e6, 5e6, 5e6, 0, 0, 0) if name == "start" else (0, 5e6, 5e6, 0, 0, 0)
            bearing = fmbd.bushing(name, fmbd.ground, rod.surface(name), stiffness=k, damping=(10, 50, 50, 0, 0, 0))
            scene.add(bearing)
        return scene

    spin = fmbd.Spin(0.0, (1, 0, 0), bodies=("shaft", "disc"))
    speeds = [0.0, 50.0, 100.0, 150.0, 200.0]
    found = fmbd.campbell(make, speeds, 2, spin=spin)
    assert (found.omega > 100.0).all()
    assert len(found.critical_speeds) == 1 and 160.0 < found.critical_speeds[0] < 163.0
    assert str(found).endswith(f"critical speeds: {found.critical_speeds[0]:.6g}")
    lines = str(found).splitlines()
    assert len(lines) == len(speeds) + 3 and "mode 1" in lines[1]


def test_the_free_turn_of_a_solid_shaft_is_no_mode_of_its_diagram() -> None:
    """Its double zero is parted by the root of roundoff: it was the first mode at each speed but zero, with a critical speed."""
    mesh = fmbd.read_gmsh(
        "meshes/block.py", size=(1.0, 0.1, 0.1), origin=(0.0, -0.05, -0.05), counts=(10, 2, 2), quads=True
    )
    solid = fmbd.FloatingBody("shaft", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(2e9, 0.3))
    for body in (solid, solid.reduced(basis=fmbd.CraigBampton(("left", "right"), 4))):
        scene = fmbd.Scene("shaft")
        scene.add(body, fmbd.revolute("left", fmbd.ground, body.surface("left"), center=(0, 0, 0), axis=(1, 0, 0)))
        scene.add(fmbd.cylindrical("right", fmbd.ground, body.surface("right"), center=(1, 0, 0), axis=(1, 0, 0)))
        found = fmbd.campbell(lambda speed, scene=scene: scene, [0.0, 50.0, 200.0], 3, spin=fmbd.Spin(0.0, (1, 0, 0)))

        assert (found.omega > 0.5 * found.omega[0, 0]).all()
        assert not found.critical_speeds
        # forward and backward whirl, each a little off the rate at rest by the rotary inertia of the section
        for rates in found.fixed[1:]:
            assert np.sign(rates).tolist() == [1.0, -1.0, 1.0]
            assert np.abs(rates[:2]) == pytest.approx(found.omega[0, 0], rel=5e-3)
            # the antisymmetric one, which leaves the middle at rest
            assert rates[2] == pytest.approx(found.omega[0, 2], rel=5e-3)


@pytest.mark.parametrize("speed", [0.0, 300.0])
def test_an_overhung_rotor_on_a_mount_that_resists_tilts(speed: float) -> None:
    """The mount holds a ring in which the rotor turns; on the rotor itself it would measure the turn too, which is told."""
    k, tilt, cross, spin = 1e6, 1e5, 3e4, fmbd.Spin(speed, bodies=("rotor",))
    K = np.diag([k, k, 1e9, tilt, tilt, 1e5])
    K[0, 4] = K[4, 0] = cross
    K[1, 3] = K[3, 1] = -cross

    def overhung(*, ring: bool) -> fmbd.Scene:
        scene, rotor = fmbd.Scene("overhung"), fmbd.RigidBody("rotor", 10.0, (0.1, 0.1, 0.18))
        held = fmbd.RigidBody("ring", 1e-6, (1e-9, 1e-9, 1e-9)) if ring else rotor
        scene.add(rotor, fmbd.bushing("mount", fmbd.ground, held, center=(0, 0, 0), stiffness=K))
        if ring:
            scene.add(held, fmbd.revolute("bearing", held, rotor, center=(0, 0, 0)))
        return scene

    M, G, K4 = np.diag([10.0, 10.0, 0.1, 0.1]), np.zeros((4, 4)), K[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
    G[2, 3], G[3, 2] = 0.18 * speed, -0.18 * speed
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(M, K4), -np.linalg.solve(M, G)]])
    rates = np.sort(np.abs(eig(A, right=False).imag))[::2]

    scene = overhung(ring=True)
    found = fmbd.modes(scene, 6 if speed else 5, at=fmbd.equilibrium(scene, spin=spin))
    assert np.sort(found.omega)[-4:] == pytest.approx(rates, rel=1e-6)  # after the free turn
    if speed:
        with pytest.raises(InputError, match='rotation of "rotor" is not steady.*light ring'):
            fmbd.equilibrium(overhung(ring=False), spin=spin)
        with pytest.raises(InputError, match='stiffness of "rotor" changes as they turn.*light ring'):
            fmbd.campbell(lambda _: overhung(ring=False), [0.0], 4, spin=spin)
