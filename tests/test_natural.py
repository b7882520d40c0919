"""Natural frequencies of one body against those of a scene and of a beam, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError

HEIGHT, MODULUS, DENSITY = 0.05, 1e7, 1e3


def rod(**law: object) -> fmbd.FloatingBody:
    """A slender strip."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, HEIGHT), origin=(0.0, -HEIGHT / 2), counts=(12, 1))
    law = law or {"elastic": fmbd.materials.plane_stress(MODULUS, 0.3)}
    return fmbd.FloatingBody("rod", mesh, density=DENSITY, **law)  # type: ignore[arg-type]


@pytest.mark.mpi
def test_free_and_held() -> None:
    """A slender free strip bends like a beam; a held one has the frequencies of a scene with that joint."""
    body = rod()
    beam = 4.730041**2 * np.sqrt(MODULUS * HEIGHT**2 / 12 / DENSITY) / (2.0 * np.pi)
    assert body.frequencies(1)[0] == pytest.approx(beam, rel=0.02)

    scene = fmbd.Scene("rod")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    assert body.frequencies(3, held="left") == pytest.approx(fmbd.modes(scene, 3).frequencies, rel=1e-7)


@pytest.mark.parametrize("dim", [2, 3])
def test_bodies_of_modes(dim: int) -> None:
    """Reduced bodies and beams have the frequencies of a scene that holds their surfaces, free ones those of the field."""
    if dim == 2:
        full, section = rod(), fmbd.Section(1e6, 1e2, 50.0, rhoI=1e-2)
    else:
        mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.2, 0.1), counts=(3, 1, 1))
        full = fmbd.FloatingBody("rod", mesh, density=1e3, elastic=fmbd.materials.linear_elastic(MODULUS, 0.3))
        section = fmbd.Section.circle(youngs_modulus=MODULUS, poisson_ratio=0.3, density=DENSITY, radius=0.05)
    few = full.reduced(basis=fmbd.CraigBampton(("left", "right"), 20))
    assert few.frequencies(2) == pytest.approx(full.frequencies(2), rel=2e-3)

    beam = fmbd.Beam("beam", (0.0,) * dim, (1.0,) + (0.0,) * (dim - 1), section, modes=12)
    for body, ends in ((few, ("left", "right")), (beam, ("start", "end"))):
        for held in (ends[:1], ends):
            scene = fmbd.Scene("held")
            scene.add(body, *(fmbd.fixed(end, fmbd.ground, body.surface(end)) for end in held))
            assert body.frequencies(2, held=held) == pytest.approx(fmbd.modes(scene, 2).frequencies, rel=1e-6)

    assert len(full.reduced(modes=2).frequencies(2)) == 2
    with pytest.raises(InputError, match="3 natural frequencies asked for; its 2 modes have 2"):
        full.reduced(modes=2).frequencies(3)
    with pytest.raises(InputError, match='no surface "tip"'):
        few.frequencies(1, held="tip")


def test_bad_input() -> None:
    """Energies, surfaces that are not there, numbers that are none."""
    with pytest.raises(InputError, match=r"linear form.*fmbd\.modes"):
        rod(energy=fmbd.materials.saint_venant_kirchhoff(MODULUS, 0.3)).frequencies(1)
    with pytest.raises(InputError, match="modes need the linear form"):  # before a scene is built with it
        rod(energy=fmbd.materials.saint_venant_kirchhoff(MODULUS, 0.3)).reduced(modes=2)
    with pytest.raises(InputError, match=r'no surface "lft".*Did you mean "left"'):
        rod().frequencies(1, held="lft")
    with pytest.raises(InputError, match="whole number, at least 1"):
        rod().frequencies(0)
    with pytest.raises(InputError, match="1000 modes asked for"):
        rod().frequencies(1000)


@pytest.mark.parametrize("size", [1.0, 1e-9, 1e-5, 1e3, 1e7])
def test_the_rotation_of_small_surfaces_is_held(size: float) -> None:
    """A strip clamped at an end of any size bends as one of metres, by itself and reduced with that end as interface."""
    height = HEIGHT * size
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, HEIGHT), origin=(0.0, -HEIGHT / 2), counts=(12, 1), scale=size)
    body = fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=fmbd.materials.plane_stress(MODULUS, 0.3))
    beam = 1.875104**2 / size**2 * np.sqrt(MODULUS * height**2 / 12 / DENSITY) / (2.0 * np.pi)
    assert body.frequencies(1, held="left")[0] == pytest.approx(beam, rel=0.02)

    few = body.reduced(basis=fmbd.CraigBampton(("left",), 3))
    finer = few.with_refined_basis(("left", "right"))
    assert len(finer.reduction.omega) == 20  # in all sizes: none of the moments of the ends is left out
    scene = fmbd.Scene("rod")
    scene.add(few, fmbd.fixed("clamp", fmbd.ground, few.surface("left")))
    assert fmbd.modes(scene, 1).frequencies[0] == pytest.approx(beam, rel=0.02)


@pytest.mark.parametrize(("size", "modulus", "density"), [(1.0, 1e9, 1e3), (1e-6, 160e9, 2330.0), (1e-9, 1e12, 1e4)])
def test_small_beams_rest_as_large_ones(size: float, modulus: float, density: float) -> None:
    """Under a small load the tip of a reduced beam stays near its place: no step of ten seconds takes it across the clamp."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, HEIGHT), origin=(0.0, -HEIGHT / 2), counts=(20, 2), scale=size)
    solid = fmbd.FloatingBody("rod", mesh, density=density, elastic=fmbd.materials.plane_stress(modulus, 0.3))
    few = solid.reduced(basis=fmbd.CraigBampton(("left", "right"), 4))
    scene = fmbd.Scene("rod")
    pull = 1e-2 * modulus * (HEIGHT * size) ** 3 / 12 / size**2
    scene.add(few, fmbd.fixed("clamp", fmbd.ground, few.surface("left")))
    scene.add(fmbd.force("pull", few.surface("right"), lambda t: (0.0, pull)))
    scene.sensor("tip", fmbd.position(few.surface("right")))
    rest = fmbd.equilibrium(scene)
    np.testing.assert_allclose(rest["tip"] / size, (1.0, 1e-2 / 3), rtol=0.01)
    assert fmbd.modes(scene, 1, at=rest).frequencies[0] > 0.0


THIN = [0.02, 0.005]


def plate(thickness: float) -> fmbd.FloatingBody:
    """A square plate of 1 m in hexahedra."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 1.0, thickness), counts=(4, 4, 1), quads=True)
    return fmbd.FloatingBody("plate", mesh, density=2700.0, elastic=fmbd.materials.linear_elastic(7e10, 0.3))


@pytest.mark.mpi
@pytest.mark.parametrize("thickness", THIN)
def test_thin_plates(thickness: float) -> None:
    """A plate 50 and 200 times as long as thick, held at its narrow face: by itself and in a scene alike; the first frequency is
    below that of a clamped plate (3.492 of its unit), as the face may warp, and above that of a strip (3.516 sqrt(1 - nu^2)).
    """
    body = plate(thickness)
    scene = fmbd.Scene("plate")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    seen = fmbd.modes(scene, 3).frequencies
    assert body.frequencies(3, held="left") == pytest.approx(seen, rel=1e-5)

    bending = 7e10 * thickness**3 / 12 / (1.0 - 0.3**2)
    unit = np.sqrt(bending / (2700.0 * thickness)) / (2.0 * np.pi)
    assert 3.516 * np.sqrt(1.0 - 0.3**2) < seen[0] / unit < 3.492


def clamped(thickness: float) -> float:
    """The first frequency of the plate in a scene, in its unit."""
    body = plate(thickness)
    scene = fmbd.Scene("plate")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    unit = np.sqrt(7e10 * thickness**3 / 12 / (1.0 - 0.3**2) / (2700.0 * thickness)) / (2.0 * np.pi)
    return float(fmbd.modes(scene, 3).frequencies[0] / unit)


@pytest.mark.parametrize("thickness", [3e-3, 1e-3])
def test_thin_plates_bend_in_frames_at_their_clamps(thickness: float, caplog: pytest.LogCaptureFixture) -> None:
    """Increments stay at the roundoff of a thin plate: it was refused as loaded above its limit."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.1, thickness), counts=(10, 1, 1), quads=True)
    frame = fmbd.Attached("left")
    steel = fmbd.materials.linear_elastic(2e11, 0.0)
    plate = fmbd.FloatingBody("plate", mesh, density=7.8e3, elastic=steel, frame=frame)
    load = 3.0 * 2e11 * 0.1 * thickness**3 / 12.0 * 1e-3  # for a thousandth of the length
    scene = fmbd.Scene("plate")
    scene.add(plate, fmbd.fixed("clamp", fmbd.ground, plate.surface("left")))
    scene.add(fmbd.force("load", plate.surface("right"), (0.0, 0.0, -load)))
    scene.sensor("tip", fmbd.position(plate.surface("right")))
    bent = fmbd.equilibrium(scene)["tip"][2] - 0.5 * thickness
    assert bent == pytest.approx(-1e-3, rel=1e-2)
    assert thickness < 3e-3 or "roundoff of forces" not in caplog.text  # below it may be told


def test_modes_of_very_thin_plates(caplog: pytest.LogCaptureFixture) -> None:
    """At 1 : 1000 the space of motions has to grow beyond its usual size (3.464 within it); where roundoff leaves nothing to
    settle by, it is said.
    """
    usual = clamped(0.002)
    assert not [x for x in caplog.messages if "settle" in x]
    assert clamped(0.001) == pytest.approx(usual, rel=1e-3)

    clamped(0.0002)
    assert [x for x in caplog.messages if "did not settle" in x]


def test_modes_of_a_shaft_that_turns_freely(caplog: pytest.LogCaptureFixture) -> None:
    """Its free turn answers most to little inertia: the noise of that hid its torsion, 1e-6 off, and modes did not settle."""
    mesh = fmbd.read_gmsh(
        "meshes/block.py", size=(1.0, 0.1, 0.1), origin=(0.0, -0.05, -0.05), counts=(10, 2, 2), quads=True
    )
    bar = fmbd.FloatingBody("bar", mesh, density=1e3, elastic=fmbd.materials.linear_elastic(2e9, 0.3))
    discs = [fmbd.RigidBody(f"disc {x:g}", 50.0, (0.05, 3.0, 3.0), position=(x, 0.0, 0.0)) for x in (0.0, 1.0)]
    scene = fmbd.Scene("shaft")
    scene.add(bar, *discs)
    scene.add(fmbd.fixed("left", discs[0], bar.surface("left")), fmbd.fixed("right", bar.surface("right"), discs[1]))
    hinge = fmbd.revolute("hinge", fmbd.ground, discs[0], axis=(1.0, 0.0, 0.0))
    scene.add(hinge, fmbd.cylindrical("back", fmbd.ground, discs[1], axis=(1.0, 0.0, 0.0), center=(1.0, 0.0, 0.0)))
    seen = fmbd.modes(scene, 3).omega
    assert not [x for x in caplog.messages if "settle" in x]
    # a turn held softly, which lifts torsion by 1 / (4 omega^2 J) of the stiffness, the bar's inertia left out
    scene.add(fmbd.joint_spring("soft", fmbd.angle(hinge), stiffness=1.0))
    held = fmbd.modes(scene, 3).omega[2]
    assert seen[0] < 1e-5 and seen[2] == pytest.approx(held, rel=4e-5)


def test_an_attached_frame_has_the_clamped_modes_of_its_joint() -> None:
    """In the frame of a face, wider than thick, that a joint holds few modes are those of the field: both see one rotation."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.3, 0.05), counts=(8, 4, 1), quads=True)
    steel = fmbd.materials.linear_elastic(7e10, 0.3)
    bar = fmbd.FloatingBody("bar", mesh, density=2700.0, elastic=steel, frame=fmbd.Attached("left"))
    found = []
    for body in (bar, bar.reduced(modes=6)):
        scene = fmbd.Scene("bar")
        scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
        found.append(fmbd.modes(scene, 4).frequencies)
    assert found[1] == pytest.approx(found[0], rel=1e-7)
