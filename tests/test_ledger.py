"""The ledger: works of all elements explain the change of energy, to the error of the scheme."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import linear_elastic

BOOKED = fmbd.Output(ledger=True)


def rests(make: Callable[[], fmbd.Scene], t_end: float, dt: float, **more: Any) -> tuple[float, float, fmbd.Run]:
    """Largest rest with dt and dt / 2, and the second run."""
    runs = [fmbd.solve(make(), t_end=t_end, dt=h, output=BOOKED, **more) for h in (dt, dt / 2)]
    return *(float(np.abs(r.ledger.rest).max()) for r in runs), runs[1]


def machine(dim: int) -> fmbd.Scene:
    """Two links under weight: a drive, a controller, springs, dampers, friction, a force in time."""
    flat = dim == 2
    J = 0.1 if flat else (0.05, 0.1, 0.1)
    place = lambda *x: x if flat else (*x, 0.0)  # noqa: E731
    scene = fmbd.Scene("machine", gravity=(0, -9.81, 0)[:dim], gravity_ramp=0.2)
    one = fmbd.RigidBody("one", 1.0, J, position=place(0.5, 0.0))
    two = fmbd.RigidBody("two", 0.7, J, position=place(1.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, one, center=place(0.0, 0.0))
    elbow = fmbd.revolute("elbow", one, two, center=place(1.0, 0.0))
    scene.add(one, two, pin, elbow)
    scene.add(fmbd.drive("drive", fmbd.angle(pin), lambda t: 0.4 * t**3))
    scene.add(fmbd.pid("motor", fmbd.angle(elbow), target=0.5, gains=(8.0, 4.0, 1.0)))
    scene.add(fmbd.joint_spring("bearing", fmbd.angle(elbow), stiffness=3.0, damping=0.2))
    scene.add(fmbd.forces.joint_friction("friction", fmbd.angle(elbow), coulomb=0.3, speed=0.1))
    scene.add(fmbd.Spring("stay", fmbd.ground, two, place(2.0, 1.0), place(2.0, 0.0), stiffness=20.0, damping=0.5))
    scene.add(fmbd.force("push", two, lambda t: (np.sin(5 * t), 2.0, 0.0)[:dim], point=place(2.0, 0.0)))
    return scene


@pytest.mark.parametrize("dim", [2, 3])
def test_works_of_rigid_elements_explain_the_energy(dim: int) -> None:
    coarse, fine, run = rests(lambda: machine(dim), 0.5, 5e-3)
    book = run.ledger
    assert {"drive", "motor", "bearing", "friction", "stay", "push", "gravity"} == set(book.work)
    assert np.abs(book.change).max() > 0.3
    assert fine < 1e-3 * np.abs(book.change).max() and 3.4 < coarse / fine < 4.6, (coarse, fine)
    assert book["friction"][-1] < 0 < book["drive"][-1]
    assert "stay" in str(book) and "rest" in str(book)


def driven_crank() -> fmbd.Scene:
    """A crank that is driven, its rod and slider, all in line at the start."""
    scene = fmbd.Scene("crank", gravity=(0, -9.81))
    crank, rod, slider = (
        fmbd.RigidBody(n, m, J, (x, 0.0))
        for n, m, J, x in (("a", 1, 0.05, 0.15), ("b", 2, 0.2, 0.7), ("c", 3, 0.1, 1.1))
    )
    pins = [
        fmbd.revolute(f"pin {x}", a, b, center=(x, 0))
        for x, a, b in ((0, fmbd.ground, crank), (0.3, crank, rod), (1.1, rod, slider))
    ]
    rail = fmbd.prismatic("rail", fmbd.ground, slider, axis=(1, 0))
    turn = lambda t: 3 * t + 0.5 * np.sin(7 * t)
    scene.add(crank, rod, slider, *pins, rail, fmbd.drive("motor", fmbd.angle(pins[0]), turn))
    return scene


def test_works_of_drives_are_of_corrected_multipliers() -> None:
    """Those of the stages were booked unless a sensor read reactions: a crank's drive was off by an eighth of its work."""
    run = fmbd.solve(driven_crank(), t_end=1.0, dt=2e-3, scheme=fmbd.Radau(2, fmbd.Index3(), rtol=None), output=BOOKED)
    work = run.ledger.work["motor"]
    assert abs(run.ledger.rest[-1]) < 1e-3 * np.abs(work).max()


@pytest.mark.parametrize(
    ("scheme", "dt"),
    [(fmbd.Radau(2), None), (fmbd.BDF(), None), (fmbd.BDF(2, rtol=None), 2e-3)],
    ids=lambda x: str(x)[:5],
)
def test_states_that_a_run_keeps_have_corrected_multipliers(scheme: Any, dt: float | None) -> None:
    """The last one and snapshots, of which pictures and modes are: they had those of the stages, 2e-3 off, where no sensor read
    any.
    """
    scene, kept = driven_crank(), fmbd.Output(snapshots=4, progress=False)
    size = {} if dt is None else {"dt": dt}
    alone = fmbd.solve(scene, t_end=0.3, scheme=scheme, output=kept, **size)
    scene.sensor("motor", fmbd.reaction_force("pin 0.3"))
    read = fmbd.solve(scene, t_end=0.3, scheme=scheme, output=kept, **size)
    for found, right in zip([*alone.snapshots, alone.state], [*read.snapshots, read.state], strict=True):
        assert found.t == right.t and np.abs(found.lam - right.lam).max() < 1e-7 * np.abs(right.lam).max()


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["floating", "reduced", "absolute"])
def test_loads_and_damping_of_elastic_bodies_are_listed(rod_mesh: Callable[..., Any], kind: str) -> None:
    """A damped rod on a pin, under weight and a traction in time."""
    make = fmbd.AbsoluteBody if kind == "absolute" else fmbd.FloatingBody
    load = fmbd.loads.traction("tip", (0.0, 200.0), time=lambda t: np.sin(20 * t))
    rod = make(
        "rod", rod_mesh(dim=2, h=0.3), density=100.0, elastic=linear_elastic(1e6, 0.3), loads=(load,),
        stiffness_damping=2e-3, mass_damping=0.5,
    )  # fmt: skip
    rod = rod.reduced(modes=4) if kind == "reduced" else rod

    def scene() -> fmbd.Scene:
        made = fmbd.Scene("rod", gravity=(0.0, -1.0))
        made.add(rod, fmbd.fixed("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        return made

    coarse, fine, run = rests(scene, 0.1, 1e-3)
    book = run.ledger
    assert set(book.work) == {"rod, loads", "rod, damping"}
    assert book["rod, damping"][-1] < 0
    assert fine < 5e-3 * np.abs(book["rod, damping"]).max() and coarse / fine > 3.0, (coarse, fine)


def test_rods_list_loads_and_damping() -> None:
    section = fmbd.RodSection((1e4, 1e4, 1e4, 50, 50, 50), 1.0, (0.02, 0.01, 0.01))
    load = fmbd.RodLoad(lambda s, t: (0.0, 5.0 * np.sin(6 * t), 0.0))

    def scene() -> fmbd.Scene:
        rod = fmbd.Rod("whip", [(0, 0, 0), (1, 0, 0)], section, elements=3, loads=(load,), damping=5e-3)
        made = fmbd.Scene("whip")
        made.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
        return made

    coarse, fine, run = rests(scene, 0.3, 6e-3)
    assert set(run.ledger.work) == {"whip, loads", "whip, damping"}
    assert fine < 1e-2 * np.abs(run.ledger["whip, loads"]).max() and coarse / fine > 3.0, (coarse, fine)


def test_contact_and_friction_are_listed() -> None:
    """A block slides to rest on a rough floor: friction took its energy."""
    block = fmbd.RigidBody("block", 1.0, 0.01, position=(0, 0.05), velocity=(1.0, 0.0))
    scene = fmbd.Scene("slide", gravity=(0, -9.81))
    floor = fmbd.contacts.Obstacle("floor", fmbd.contacts.HalfSpace((0, 0), (0, 1)))
    scene.add(
        block, fmbd.contact("touch", fmbd.contacts.corners(block, [(-0.1, -0.05), (0.1, -0.05)]), floor, friction=0.3)
    )
    book = fmbd.solve(scene, t_end=0.5, dt=1e-3, scheme=fmbd.Moreau(), output=BOOKED).ledger
    assert abs(book["friction"][-1] + 0.5) < 5e-3
    assert np.abs(book.rest).max() < 5e-3


@pytest.mark.serial
def test_ledger_goes_on_from_a_checkpoint(tmp_path: Any) -> None:
    whole = fmbd.solve(machine(2), t_end=0.1, dt=5e-3, output=BOOKED)
    plan = fmbd.Checkpoint(tmp_path, every=15)  # the newest one is not that of the end
    fmbd.solve(machine(2), t_end=0.1, dt=5e-3, output=BOOKED, checkpoint=plan)
    again = fmbd.solve(machine(2), t_end=0.1, dt=5e-3, output=BOOKED, restart=tmp_path)
    for name, work in whole.ledger.work.items():
        assert np.array_equal(work, again.ledger.work[name])


def test_what_cannot_be_is_said() -> None:
    scene = fmbd.Scene("own")
    own = fmbd.CoordinateBody("cart", np.eye(1), lambda q, v, t: -v, start=(0.0,), start_rate=(1.0,))
    scene.add(own)
    run = fmbd.solve(scene, t_end=0.1, dt=0.05, output=BOOKED)
    assert run.ledger.unlisted == ("cart",) and "not listed: loads and damping of cart" in str(run.ledger)
    with pytest.raises(InputError, match="kept no ledger"):
        fmbd.solve(scene, t_end=0.1, dt=0.05).ledger  # noqa: B018
    with pytest.raises(InputError, match="ledger needs the energies"):
        fmbd.Output(ledger=True, energy=False)
    with pytest.raises(InputError, match='there is no "moter"'):
        run.ledger["moter"]


@pytest.mark.parametrize("wanted", [{"estimate_error": True}, {"estimate_reduction": True}, {"estimate_space": True}])
def test_a_ledger_goes_with_stated_errors(wanted: dict[str, bool]) -> None:
    """The runs that errors are found by keep no energies, and no ledger."""
    run = fmbd.solve(*_swing(), output=fmbd.Output(ledger=True, **wanted), t_end=0.02, dt=0.01)
    assert run.error_estimate or run.certificate
    assert run.ledger.work["bearing"][-1] < 0


def test_a_ledger_goes_with_a_tolerance() -> None:
    run = fmbd.solve(*_swing(), output=fmbd.Output(ledger=True), t_end=0.02, tol={"tip": 1e-2})
    assert run.ledger.work["bearing"][-1] < 0


def _swing() -> tuple[fmbd.Scene]:
    mesh = fmbd.read_gmsh("meshes/rod.py", h=0.2)
    rod = fmbd.FloatingBody("rod", mesh, density=1e3, elastic=fmbd.materials.plane_stress(5e6, 0.3)).reduced(modes=3)
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0))
    scene.add(rod, pin, fmbd.joint_spring("bearing", fmbd.angle(pin), damping=5.0))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return (scene,)


def test_elements_are_asked_once_a_record() -> None:
    """A batch of laws is evaluated once for the ledger and all sensors of a record, however many these are."""

    def asked(n: int) -> float:
        calls = [0]

        def law(s: float, rate: float, t: float) -> float:
            calls[0] += 1
            return 20.0 * math.sin(s) + rate

        scene = fmbd.Scene("masses")
        for i in range(n):
            body = scene.add(fmbd.RigidBody(f"mass {i}", 1.0, 0.1, (i, 1.0)))
            spring = scene.add(fmbd.Spring(f"spring {i}", fmbd.ground, body, (i, 0.0), law=law, length=0.5))
            scene.sensor(f"tension {i}", fmbd.tension(spring))
            scene.sensor(f"force {i}", fmbd.element_force(spring))
            scene.sensor(f"power {i}", fmbd.element_power(spring))
        fmbd.solve(scene, t_end=0.1, dt=1e-2, output=BOOKED)
        return calls[0] / n

    assert asked(12) < 1.2 * asked(3)
