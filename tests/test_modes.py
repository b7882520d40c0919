"""Modes and linear models against closed forms, between placements of bodies, and what is refused."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from programs import launch
from test_traces import ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.analysis.small_motions.perturbation import Perturbation
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.layout import State

GRAVITY = 9.81


def chain(n: int, dim: int) -> fmbd.Scene:
    """Point masses on massless links of 1 m, hanging."""
    down = (0.0, -GRAVITY) if dim == 2 else (0.0, -GRAVITY, 0.0)
    scene, before = fmbd.Scene("chain", gravity=down), fmbd.ground
    for i in range(n):
        inertia: Any = 1e-12 if dim == 2 else (1e-8, 1e-8, 1e-8)
        body = fmbd.RigidBody(f"mass {i}", 1.0, inertia, position=(0.0, -1.0 - i, 0.0)[:dim])
        scene.add(body, fmbd.revolute(f"pin {i}", before, body, center=(0.0, -float(i), 0.0)[:dim]))
        before = body
    return scene


@pytest.mark.parametrize("dim", [2, 3])
def test_hung_chain(dim: int) -> None:
    """omega^2 L / g are the zeros of the Laguerre polynomial."""
    scene = chain(5, dim)
    found = fmbd.modes(scene, 5, at=fmbd.equilibrium(scene))
    exact = np.sqrt(GRAVITY * np.polynomial.laguerre.lagroots([0] * 5 + [1]))
    assert np.abs(found.omega / exact - 1.0).max() < (1e-9 if dim == 2 else 1e-7)
    assert np.abs(found.damping).max() < 1e-9


@pytest.mark.parametrize("driven", [False, True])
def test_motions_are_asked_for_together(driven: bool, monkeypatch: Any) -> None:
    """M, C and K of all of them at once are those of one after the other, about a spin with dampers; modes ask for no others."""
    scene = chain(3, 3)
    scene.add(
        fmbd.Spring("stay", fmbd.ground, scene.bodies["mass 2"], (1, 0, 0), stiffness=50.0, damping=3.0, length=1.0)
    )
    system, given, _ = scene.build()
    if driven:
        use_driver(system)
    rng, n = np.random.default_rng(1), system.n_v
    q, v, a, lam = (
        system.compose(given.q, 0.01 * rng.normal(size=n)),
        *rng.normal(size=(2, n)),
        rng.normal(size=system.n_lam),
    )
    about = Perturbation(system, State(0.0, q, v, a, lam), fmbd.Spin(2.0, (0.0, 1.0, 0.0)), time=0.3)
    motions = rng.normal(size=(4, n))
    for found, one in zip(about.images(motions), (about.mass, about.damping, about.stiffness), strict=True):
        each = np.array([one(y) for y in motions])
        np.testing.assert_allclose(found, each, rtol=0, atol=1e-11 * np.abs(each).max())

    hung = fmbd.equilibrium(scene)
    for name in ("mass", "damping", "stiffness"):
        monkeypatch.setattr(Perturbation, name, None)
    fmbd.modes(scene, 3, at=hung)


def two_masses(damping: float) -> fmbd.Scene:
    """Masses of 1 and 2 kg on springs of 3 and 5 N/m in a row."""
    scene = fmbd.Scene("two")
    a = fmbd.RigidBody("a", 1.0, 1.0, position=(1.0, 0.0))
    b = fmbd.RigidBody("b", 2.0, 1.0, position=(2.0, 0.0))
    guide_a = fmbd.prismatic("guide a", fmbd.ground, a, axis=(1.0, 0.0))
    guide_b = fmbd.prismatic("guide b", fmbd.ground, b, axis=(1.0, 0.0))
    scene.add(a, b, guide_a, guide_b, fmbd.Spring("middle", a, b, (1.0, 0.0), (2.0, 0.0), stiffness=5.0, length=1.0))
    scene.add(fmbd.joint_spring("wall", fmbd.displacement(guide_a), stiffness=3.0, damping=damping))
    scene.add(fmbd.force("push", a, lambda t: (0.0, 0.0)))
    scene.sensor("b", fmbd.position(b))
    scene.sensor("speed", fmbd.velocity(b))
    scene.sensor("pull", fmbd.acceleration(b))
    return scene


@pytest.mark.mpi
def test_transfer_function_of_two_masses() -> None:
    """Position, velocity and acceleration of the far mass for a force on the near one, to 1e-10."""
    model = fmbd.linearise(two_masses(0.1), ["push x"], ["b x", "speed x", "pull x"])
    assert model.A.shape == (4, 4)
    omega = np.array([0.0, 0.3, 1.3, 2.9, 20.0])
    s = 1j * omega
    exact = 5.0 / ((s * s + 0.1 * s + 8.0) * (2.0 * s * s + 5.0) - 25.0)
    found = model.frequency_response(omega)[:, :, 0]
    for k in range(3):
        assert np.abs(found[:, k] - exact * s**k).max() < 1e-10
    assert model.state_space.A.shape == (4, 4)


def test_outputs_of_one_number_and_of_the_plane() -> None:
    """A whole vector has two components in the plane; a joint's coordinate is one number."""
    scene = two_masses(0.1)
    scene.sensor("way", fmbd.displacement(scene.joints["guide b"]))
    model = fmbd.linearise(scene, ["push"], ["b", "way"])
    assert model.outputs == ("b x", "b y", "way")
    H = model.frequency_response(1.3)[0]
    assert H[2] == pytest.approx(H[0], rel=1e-9) and np.abs(H[1]).max() < 1e-12


def test_reactions_of_roundoff_leave_other_outputs_as_they_are() -> None:
    """An arm on a spring, whose pin carries next to nothing at rest: places answer as without their reaction beside them."""
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.3, 0.4))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene = fmbd.Scene("arm", gravity=(0.0, -1e-28))
    scene.add(arm, pin, fmbd.effort("turn", fmbd.angle(pin), lambda t: 0.0))
    scene.add(fmbd.joint_spring("spring", fmbd.angle(pin), stiffness=2.0, damping=0.1))
    scene.sensor("place", fmbd.position(arm))
    scene.sensor("load", fmbd.reaction_force("pin"))
    place = np.array([-0.4, 0.3]) / (2.0 + 0.1j - 0.35)
    found = fmbd.frequency_response(scene, ["turn"], ["place", "load"], [1.0])[0, :, 0]
    assert found == pytest.approx(np.concatenate((place, place)), rel=1e-8)


def test_rates_of_real_eigenvalues_are_printed() -> None:
    """A pendulum on its head falls with sqrt(m g l / (J + m l^2))."""
    rod = fmbd.RigidBody("rod", 3.0, 1.0, position=(0.0, 1.0))
    scene = fmbd.Scene("head", gravity=(0.0, -10.0))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod, center=(0.0, 0.0)))
    found = fmbd.modes(scene, 1, at=fmbd.equilibrium(scene))
    assert np.abs(found.growth) == pytest.approx(np.sqrt(30.0 / 4.0), rel=1e-9)
    head, row = str(found).splitlines()[1:]
    assert head.split() == ["Hz", "rad/s", "damping", "growth", "1/s"]
    assert float(row.split()[-1]) == pytest.approx(found.growth[0], rel=1e-5)


@pytest.mark.parametrize("held", [True, False])
def test_states_in_a_motion_that_is_not_steady_are_told_of(held: bool, caplog: pytest.LogCaptureFixture) -> None:
    """A pendulum on its way down has no modes; a body that goes on as it is has."""
    scene = fmbd.Scene("swing", gravity=(0.0, -9.81) if held else None)
    body = fmbd.RigidBody("body", 1.0, 0.1, position=(1.0, 0.0), velocity=(0.0, 0.0 if held else 2.0))
    scene.add(body)
    if held:
        scene.add(fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0)))
    fmbd.modes(scene, 1, at=fmbd.solve(scene, t_end=0.2, dt=0.01))
    assert ("the motion at this state is not steady" in caplog.text) == held


@pytest.mark.parametrize("kind", ["hinge", "free", "round", "slow"])
def test_states_that_turn_with_what_holds_them_are_told_of(kind: str, caplog: pytest.LogCaptureFixture) -> None:
    """A blade on a hinge of its hub, e off the mast, swings with W sqrt(3 e / 2 l) in axes that turn; at a state in motion it had
    another rate, without a word, and a body that tumbles had none.
    """
    e, length, rate = 0.3, 5.0, 1e-6 if kind == "slow" else 40.0
    scene = fmbd.Scene("hub")
    if kind in ("free", "round"):
        inertia = (1.0, 2.0, 3.0 if kind == "free" else 1.0)
        scene.add(fmbd.RigidBody("body", 1.0, inertia, angular_velocity=(0.0, rate, 0.0)))
    else:
        hub = fmbd.RigidBody("hub", 50.0, 10.0, angular_velocity=rate)
        middle = e + length / 2
        blade = fmbd.RigidBody(
            "blade", 20.0, 20.0 * length**2 / 12, (middle, 0.0), velocity=(0.0, rate * middle), angular_velocity=rate
        )
        mast = fmbd.revolute("mast", fmbd.ground, hub, center=(0.0, 0.0))
        hinge = scene.add(fmbd.revolute("hinge", hub, blade, center=(e, 0.0)))
        scene.add(hub, blade, mast)
        if kind == "slow":  # against its own vibration
            scene.add(fmbd.joint_spring("damper", fmbd.angle(hinge), stiffness=1e4))
        scene.add(fmbd.drive("turn", fmbd.angle(mast), lambda t: rate * t))
    fmbd.modes(scene, 1)
    assert ("not steady" in caplog.text) == (kind in ("hinge", "free"))
    if kind == "hinge":
        turning = fmbd.modes(scene, 1, at=fmbd.equilibrium(scene, spin=fmbd.Spin(rate)))
        assert turning.omega[0] == pytest.approx(rate * np.sqrt(1.5 * e / length), rel=1e-9)


def test_damping_ratio_of_one_mass() -> None:
    """zeta = c / 2 sqrt(k m)."""
    scene = fmbd.Scene("one")
    mass = fmbd.RigidBody("mass", 2.0, 1.0)
    guide = fmbd.prismatic("guide", fmbd.ground, mass, axis=(1.0, 0.0))
    scene.add(mass, guide, fmbd.joint_spring("spring", fmbd.displacement(guide), stiffness=8.0, damping=0.8))
    found = fmbd.modes(scene, 1)
    assert found.damping[0] == pytest.approx(0.1, rel=1e-9)
    assert found.omega[0] == pytest.approx(2.0 * np.sqrt(1.0 - 0.01), rel=1e-9)


@pytest.mark.mpi
def test_placements_agree(rod_mesh: Any) -> None:
    """A clamped rod in a floating frame and in absolute coordinates; static gain as in the equilibrium under the load."""
    omega, gain = [], []
    for kind in (fmbd.FloatingBody, fmbd.AbsoluteBody):
        rod = kind("rod", rod_mesh(), density=1000.0, elastic=fmbd.materials.plane_stress(5e8, 0.3))
        scene = fmbd.Scene("rod")
        scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        scene.add(fmbd.force("push", rod.surface("tip"), lambda t: (0.0, t)))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        omega.append(fmbd.modes(scene, 3).omega)
        gain.append(fmbd.linearise(scene, ["push y"], ["tip y"]).frequency_response(0.0)[0, 0, 0].real)
        assert gain[-1] == pytest.approx(fmbd.equilibrium(scene, t=1.0)["tip"][1], rel=1e-4)
    assert np.abs(omega[0] / omega[1] - 1.0).max() < 1e-8
    assert gain[0] == pytest.approx(gain[1], rel=1e-8)


@pytest.mark.mpi
def test_damped_rod(rod_mesh: Any) -> None:
    """zeta = beta w / 2 for stiffness-proportional damping, and no motion that constraints forbid in the linear model."""
    values = []
    for beta in (0.0, 2e-3):
        how: Any = {"elastic": fmbd.materials.plane_stress(5e8, 0.3), "stiffness_damping": beta}
        rod = fmbd.FloatingBody("rod", rod_mesh(), density=1000.0, **how)
        scene = fmbd.Scene("rod")
        scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        scene.add(fmbd.force("push", rod.surface("tip"), lambda t: (0.0, 0.0)))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        values.append(fmbd.modes(scene, 2).eigenvalues)
    assert np.abs(values[1]) == pytest.approx(values[0].imag, rel=1e-6)
    assert values[1].real == pytest.approx(-1e-3 * values[0].imag ** 2, rel=1e-6)
    model = fmbd.linearise(scene, ["push y"], ["tip y"])
    assert np.abs(np.linalg.eigvals(model.A)).min() == pytest.approx(values[0][0].imag, rel=1e-6)


@pytest.mark.parametrize("make", [fmbd.FloatingBody, fmbd.AbsoluteBody])
def test_slender_cantilever(make: Any) -> None:
    """1 : 50: the stiffness of a cell is 1e12 times that of the beam. Euler and Bernoulli's frequencies, shear lowers them."""
    E, rho, height = 1e9, 1000.0, 0.02
    mesh = fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=2, height=height, h=height)
    rod = make("rod", mesh, density=rho, elastic=fmbd.materials.plane_stress(E, 0.0))
    scene = fmbd.Scene("cantilever")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    exact = np.array([1.8751041, 4.6940911, 7.8547574]) ** 2 * np.sqrt(E * height**2 / (12 * rho))
    share = fmbd.modes(scene, 3).omega / exact
    assert (share < 1.0 + 1e-4).all() and (share > 1.0 - np.array([1e-3, 3e-3, 8e-3])).all()


@pytest.mark.parametrize("frame", [fmbd.MeanAxis(), fmbd.Attached("left"), None])
def test_rayleigh_damping_of_a_guided_sheet(frame: Any) -> None:
    """A sheet on a slide at its end, tan k + tanh k = 0, damping ratio b omega / 2; its place is free, a double zero."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.02), origin=(0.0, -0.01), counts=(10, 1))
    law = {"density": 1e3, "elastic": fmbd.materials.plane_stress(2e9, 0.0), "stiffness_damping": 1e-4}
    sheet = fmbd.FloatingBody("sheet", mesh, frame=frame, **law) if frame else fmbd.AbsoluteBody("sheet", mesh, **law)
    scene = fmbd.Scene("slide")
    slide = fmbd.prismatic("slide", fmbd.ground, sheet.surface("left"), axis=(0.0, 1.0))
    scene.add(sheet, slide, fmbd.effort("push", fmbd.displacement(slide), lambda t: 0.0))
    scene.sensor("tip", fmbd.position(sheet.surface("right")))
    scene.sensor("base", fmbd.displacement(slide))

    found = fmbd.modes(scene, 4)
    exact = np.sqrt(2e9 * 0.02**2 / 12 / 1e3) * np.array([2.36502, 5.49780]) ** 2
    assert found.omega[:2].max() < 1e-3
    assert found.omega[2:] == pytest.approx(exact, rel=8e-3)
    assert found.damping[2:] == pytest.approx(0.5e-4 * found.omega[2:], rel=1e-4)

    # the ratio of both ends is that of a cantilever whose root is moved: (cos k + cosh k) / (1 + cos k cosh k)
    tip, base = np.abs(fmbd.frequency_response(scene, ["push"], ["tip y", "base"], [20.0])[0, :, 0])
    k = np.sqrt(20.0 / np.sqrt(2e9 * 0.02**2 / 12 / 1e3))
    assert tip / base == pytest.approx((np.cos(k) + np.cosh(k)) / (1.0 + np.cos(k) * np.cosh(k)), rel=8e-3)


@pytest.mark.parametrize(("size", "counts"), [((1.0, 0.02, 0.02), (20, 1, 1)), ((1.0, 0.001), (20, 1))])
def test_modes_of_a_free_slender_bar(size: Any, counts: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Motions of zero and bending: roundoff of the stiffness in the first is no change of them, and inertia holds the bar."""
    origin = (0.0, *(-0.5 * x for x in size[1:]))
    mesh = fmbd.read_gmsh("meshes/block.py", size=size, origin=origin, counts=counts, quads=True)
    bar = fmbd.FloatingBody("bar", mesh, density=1e3, elastic=fmbd.materials.linear_elastic(2e9, 0.3))
    scene = fmbd.Scene("bar")
    scene.add(bar)
    rigid = 3 if len(size) == 2 else 6
    found = fmbd.modes(scene, rigid + 2)
    assert not caplog.messages
    assert found.omega[:rigid].max() < 1e-3 * found.omega[rigid]
    assert found.frequencies[rigid:] == pytest.approx(bar.frequencies(2), rel=1e-5)


def test_bad_input() -> None:
    """Too many modes, states out of equilibrium, unknown names, resonance without damping."""
    scene = two_masses(0.0)
    with pytest.raises(InputError, match="has 2 modes, 3 were asked"):
        fmbd.modes(scene, 3)
    with pytest.raises(InputError, match='Unknown input "psh"'):
        fmbd.linearise(scene, ["psh"], ["b"])
    with pytest.raises(InputError, match='Input "guide a" is a joint or a drive'):
        fmbd.linearise(scene, ["guide a"], ["b"])
    with pytest.raises(InputError, match='Unknown output "c"'):
        fmbd.linearise(scene, ["push"], ["c"])
    with pytest.raises(InputError, match=r"frequency_response: omega \['a'\] must be finite numbers .rad/s."):
        fmbd.linearise(scene, ["push x"], ["b x"]).frequency_response(["a"])  # type: ignore[list-item]
    with pytest.raises(InputError, match="Undamped resonance"):
        fmbd.frequency_response(scene, ["push x"], ["b x"], [fmbd.modes(scene, 1).omega[0]])
    tilted = fmbd.Scene("tilted", gravity=(0.0, -GRAVITY))
    rod = fmbd.RigidBody("rod", 1.0, 0.1, position=(0.5, 0.0))
    tilted.add(rod, fmbd.revolute("pin", fmbd.ground, rod, center=(0.0, 0.0)))
    with pytest.raises(InputError, match=r"not in equilibrium.*accelerate with"):
        fmbd.modes(tilted, 1)


def test_forward_and_backward_whirl() -> None:
    """An oscillator of 2 rad/s circles with +2 and -2 at rest, and is seen with 2 - W and 2 + W in axes that turn with W; its
    critical speed is 2 rad/s.
    """
    scene = fmbd.Scene("whirl")
    mass = fmbd.RigidBody("mass", 1.0, 1.0)
    scene.add(mass)
    for i, (x, y) in enumerate(((10.0, 0.0), (-10.0, 0.0), (0.0, 10.0), (0.0, -10.0))):
        scene.add(fmbd.Spring(f"spring {i}", fmbd.ground, mass, (x, y), (0.0, 0.0), stiffness=2.0, length=10.0))
    hold = lambda t, at: (np.zeros(2), np.array([-50.0 * np.arctan2(at.R[1, 0], at.R[0, 0])]))  # noqa: E731
    scene.add(fmbd.own_force("hold", mass, None, hold))
    found = fmbd.campbell(lambda speed: scene, [0.7, 1.5, 2.5], 2)
    assert found.omega[0] == pytest.approx((2.0 - 0.7, 2.0 + 0.7), rel=1e-7)
    assert np.sort(found.fixed, axis=1) == pytest.approx(np.array([[-2.0, 2.0]] * 3), rel=1e-6)
    assert found.critical_speeds == pytest.approx([2.0], rel=1e-6)


RANKS = """
import json
import numpy as np
from mpi4py import MPI
import fmbd_fenicsx as fmbd
mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.1), origin=(0.0, -0.05), counts=(4, 1))
law = fmbd.materials.saint_venant_kirchhoff(1e6, 0.3)
how = {"density": 1e3, "energy": law, "stiffness_damping": 2e-3}
rod = fmbd.AbsoluteBody("rod", mesh, **how)
scene = fmbd.Scene("rod")
clamp = fmbd.fixed("clamp", fmbd.ground, rod.surface("left"))
scene.add(rod, clamp, fmbd.force("push", rod.surface("right"), lambda t: (0.0, -60.0 * t)))
scene.sensor("tip", fmbd.position(rod.surface("right")))
scene.sensor("force", fmbd.reaction_force(clamp))
found = fmbd.equilibrium(scene, t=0.5, path=fmbd.ArcLength(1.0, step=0.5))
values = fmbd.modes(scene, 2, at=found).eigenvalues
answer = fmbd.linearise(scene, ["push y"], ["tip y"], at=found, modes=2).frequency_response([0.0, 3.0])
small = [found["tip"], found["force"], found.path.parameter, values.real, values.imag, answer.real, answer.imag]
small = [np.ravel(x).tolist() for x in small]
every = MPI.COMM_WORLD.gather(small)
if MPI.COMM_WORLD.rank == 0:
    assert all(x == small for x in every)
    print(json.dumps(small))
"""


@pytest.mark.serial
@pytest.mark.slow
def test_two_ranks_give_the_figures_of_one() -> None:
    """A path of equilibria far from the linear one, damped modes about its end, and a linear model."""
    one, two = (json.loads(launch(RANKS, n, timeout=300).stdout.splitlines()[-1]) for n in (1, 2))
    assert one[2] == pytest.approx(two[2], rel=1e-9)  # the same points of the path
    for a, b, tolerance in zip(one, two, (1e-9, 1e-9, 1e-9, 1e-6, 1e-7, 1e-6, 1e-6), strict=True):
        assert np.abs(np.subtract(a, b)).max() <= tolerance * np.abs(a).max()


@pytest.mark.serial
@pytest.mark.slow
def test_functions_that_depend_on_the_rank_are_refused() -> None:
    """As in a run."""
    for call in ("fmbd.equilibrium(scene, t=1.0)", "fmbd.linearise(scene, ['push y'], ['tip y'])"):
        begun = RANKS[: RANKS.index("found =")].replace("-60.0 * t", "-60.0 * t - MPI.COMM_WORLD.rank")
        done = launch(begun + call, 2, timeout=120)
        assert done.returncode == 2 and "on rank 1 for the same arguments" in done.stderr


def test_roundoff_is_no_motion() -> None:
    """A stiff spring that is out by roundoff pulls at a light body: still an equilibrium, without any weight to compare with."""
    scene = fmbd.Scene("stiff")
    mass = fmbd.RigidBody("mass", 0.5, 1.0)
    guide = fmbd.prismatic("guide", fmbd.ground, mass, axis=(1.0, 0.0))
    scene.add(mass, guide, fmbd.joint_spring("spring", fmbd.displacement(guide), stiffness=5e5, free=1e-16))
    assert fmbd.modes(scene, 1).omega[0] == pytest.approx(1e3, rel=1e-7)
    scene.add(fmbd.force("pull", mass, lambda t: (1.0, 0.0)))
    with pytest.raises(InputError, match="accelerate with 2 m/s"):
        fmbd.modes(scene, 1)


def test_slow_motions_do_not_hide_fast_ones(rod_mesh: Any) -> None:
    """A stiff rod that swings slowly: its bending frequencies are those of the reduced rod, to what twelve modes leave."""
    found = []
    for reduce in (False, True):
        law = fmbd.materials.plane_stress(1e9, 0.3)
        body: Any = fmbd.FloatingBody("rod", rod_mesh(2), degree=2, density=1000.0, elastic=law)
        body = body.reduced(modes=12) if reduce else body
        scene = fmbd.Scene("pendulum", gravity=(9.81, 0.0))
        scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0)))
        found.append(fmbd.modes(scene, 3, at=fmbd.equilibrium(scene)).omega)
    assert found[0] == pytest.approx(found[1], rel=1e-2)


@pytest.mark.parametrize(("inputs", "outputs", "what"), [([], ["phi"], "inputs"), (["turn"], [], "outputs")])
def test_a_response_of_nothing_is_refused(inputs: list[str], outputs: list[str], what: str) -> None:
    """The matrix of the motion alone is a model: its eigenvalues are those of the modes."""
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.0, -0.5))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene = fmbd.Scene("arm", gravity=(0, -9.81))
    scene.add(arm, pin, fmbd.effort("turn", fmbd.angle(pin), lambda t: 0.0))
    scene.sensor("phi", fmbd.angle(pin))
    with pytest.raises(InputError, match=f"{what} = .. names nothing"):
        fmbd.frequency_response(scene, inputs, outputs, [1.0])
    model = fmbd.linearise(scene, inputs, outputs)
    assert (model.B.shape[1], model.C.shape[0]) == (len(inputs), len(outputs))
    assert np.abs(np.linalg.eigvals(fmbd.linearise(scene).A)) == pytest.approx(fmbd.modes(scene, 1).omega[0], rel=1e-6)


def test_sprung_hinges_of_thin_panels() -> None:
    """Modes of reduced panels that turn their thin ends far are those of the panels as fields: angles are not linear in them."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=2, height=0.01, h=0.1)
    found: list[Any] = []
    for reduce in (False, True):
        scene, before = fmbd.Scene("wing"), fmbd.ground
        for k in range(2):
            law = fmbd.materials.plane_stress(1e8, 0.0)
            panel: Any = fmbd.FloatingBody(f"panel {k}", mesh.placed((k, 0.0)), degree=2, density=100.0, elastic=law)
            panel = panel.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 8)) if reduce else panel
            hinge = fmbd.revolute(f"hinge {k}", before, panel.surface("pin"), center=(k, 0.0))
            scene.add(panel, hinge, fmbd.joint_spring(f"spring {k}", fmbd.angle(hinge), stiffness=1.0))
            before = panel.surface("tip")
        found.append(fmbd.modes(scene, 4).omega)
    assert found[0] == pytest.approx(found[1], rel=1e-4)


@pytest.mark.parametrize("damping", [0.0, 1e-7])
@pytest.mark.parametrize("heavier", [1e8, 1e12])
def test_a_mass_far_heavier_than_its_beam(heavier: float, damping: float) -> None:
    """By reduced and full bodies sqrt(k / m), k of Timoshenko's beam, although squares of frequencies are up to 1e19 apart."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.05), origin=(0.0, -0.025), counts=(20, 2))
    law, mass = fmbd.materials.plane_stress(1e7, 0.0), 0.05 * heavier
    full = fmbd.FloatingBody("beam", mesh, density=1.0, elastic=law, stiffness_damping=damping)
    expected = np.sqrt(1.0 / (4.0 / (1e7 * 0.05**3) + 1.0 / (5e6 * 0.05 * 5.0 / 6.0)) / (mass + 33.0 / 140.0 * 0.05))

    for beam in (full, full.reduced(basis=fmbd.CraigBampton(("left", "right"), 4))):
        scene = fmbd.Scene("tip")
        tip = fmbd.RigidBody("tip", mass, 1e-12 * mass, position=(1.0, 0.0))
        scene.add(beam, tip, fmbd.fixed("clamp", fmbd.ground, beam.surface("left"), center=(0.0, 0.0)))
        scene.add(fmbd.fixed("weld", beam.surface("right"), tip, center=(1.0, 0.0)))
        assert fmbd.modes(scene, 2).omega[0] == pytest.approx(expected, rel=2e-4)


def slender(load: Any) -> fmbd.Scene:
    """A clamped rod of bending stiffness, mass and length 1 that hardly stretches, with what ``load`` gives of its end."""
    rod = fmbd.Rod(
        "rod",
        [(0, 0, 0), (1, 0, 0)],
        fmbd.RodSection((1e8, 1e8, 1e8, 1.0, 1.0, 1.0), 1.0, (2e-8, 1e-8, 1e-8)),
        elements=4,
    )
    scene = fmbd.Scene("column")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")), load(rod.surface("end")))
    return scene


@pytest.mark.parametrize(("force", "flutters"), [(10.0, False), (19.9, False), (20.2, True)])
def test_a_column_under_a_force_that_follows_it_flutters(force: float, flutters: bool) -> None:
    """Beck's load 20.05 EI / L^2: what the stiffness lacks of symmetry is 1e-9 of the stretch and shear beside it."""
    scene = slender(lambda end: fmbd.force("push", end, (-force, 0.0, 0.0), follower=True))
    found = fmbd.modes(scene, 4, at=fmbd.equilibrium(scene)).eigenvalues
    assert found.imag.min() > 5.0
    assert bool(found.real.max() > 0.5) is flutters
    assert flutters or np.abs(found.real).max() < 1e-5


def test_dampers_are_seen_beside_stiff_parts() -> None:
    """l^2 + 0.05 l + 1 = 0 of a cart, whatever the spring of another one."""
    scene = fmbd.Scene("carts")
    for name, mass, stiffness, damping in (("soft", 1.0, 1.0, 0.05), ("stiff", 1e3, 1e12, 0.0)):
        cart = fmbd.RigidBody(name, mass, 1.0)
        rail = fmbd.prismatic(f"rail of {name}", fmbd.ground, cart, axis=(1, 0), center=(0.0, 0.0))
        spring = fmbd.joint_spring(f"spring of {name}", fmbd.displacement(rail), stiffness=stiffness, damping=damping)
        scene.add(cart, rail, spring)
    assert fmbd.modes(scene, 1).eigenvalues[0] == pytest.approx(-0.025 + 1j * np.sqrt(1.0 - 0.025**2), abs=1e-9)


def test_a_scene_without_free_motion_has_no_modes() -> None:
    """A drive holds the only joint."""
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0.0, 0.0))
    scene = fmbd.Scene("held")
    scene.add(
        arm, pin, fmbd.drive("motor", fmbd.angle(pin), lambda t: 0.0 * t), fmbd.effort("push", fmbd.angle(pin), 0.0)
    )
    scene.sensor("arm", fmbd.angle(pin))
    for ask in (lambda: fmbd.modes(scene, 1), lambda: fmbd.linearise(scene, ["push"], ["arm"])):
        with pytest.raises(InputError, match="leave no motion free"):
            ask()


def two_springs(masses: tuple[float, float], stiff: float) -> fmbd.Scene:
    """Two masses one behind the other on springs of 1 N/m and ``stiff``."""
    scene, before = fmbd.Scene("springs", gravity=(0.0, 0.0)), fmbd.ground
    for i, (m, k) in enumerate(zip(masses, (1.0, stiff), strict=True)):
        body = fmbd.RigidBody(f"body {i}", m, m, (float(i), 0.0))
        guide: Any = fmbd.prismatic(f"guide {i}", before, body, axis=(1, 0), center=(i, 0))
        scene.add(body, guide, fmbd.joint_spring(f"spring {i}", fmbd.displacement(guide), stiffness=k))
        before = body
    return scene


def test_modes_that_roundoff_hides_are_told(caplog: Any) -> None:
    """Beside 1e14 N/m the slow one of sqrt(1/2) rad/s is found to parts in a hundred; of 1e-12 beside 1e12 kg none is left."""
    for stiff, told in ((1e8, False), (1e14, True)):
        caplog.clear()
        assert fmbd.modes(two_springs((1.0, 1.0), stiff), 2).omega[0] == pytest.approx(np.sqrt(0.5), rel=0.1)
        assert any("known to about" in r.getMessage() for r in caplog.records) == told
    light = two_springs((1e-12, 1e12), 1e12)
    caplog.clear()
    fmbd.modes(light, 2)
    assert any("masses of others" in r.getMessage() for r in caplog.records)
    with pytest.raises(InputError, match="masses are nothing beside those of others"):
        fmbd.linearise(light)
