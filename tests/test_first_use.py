"""What a newcomer writes: constants where functions may stand, default schemes, contacts as attachments, mistyped arguments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError

C = fmbd.contacts
pytestmark = pytest.mark.serial


def arm() -> tuple[Any, Any]:
    body = fmbd.RigidBody("arm", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    return body, fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))


@pytest.mark.parametrize(
    "push",
    [
        lambda body, pin, x: fmbd.force("push", body, x((0.0, 3.0)), point=(1.0, 0.0)),
        lambda body, pin, x: fmbd.torque("push", body, x(3.0)),
        lambda body, pin, x: fmbd.effort("push", fmbd.angle(pin), x(3.0)),
    ],
    ids=["force", "torque", "effort"],
)
def test_a_constant_is_a_function_of_time(push: Any) -> None:
    ends = []
    for form in (lambda value: value, lambda value: lambda t: np.array(value)):
        body, pin = arm()
        scene = fmbd.Scene("arm")
        scene.add(body, pin, push(body, pin, form))
        scene.sensor("angle", fmbd.angle(pin))
        ends.append(fmbd.solve(scene, t_end=0.05, dt=0.01)["angle"])
    assert np.array_equal(*ends)
    assert ends[0][-1] == pytest.approx(0.5 * 3.0 / 0.35 * 0.05**2, rel=1e-2)


@pytest.mark.parametrize("law", [None, "push", np.nan, True, (1.0, np.inf), [[1.0, 2.0]], ()])
def test_what_is_neither_is_refused(law: Any) -> None:
    _, pin = arm()
    with pytest.raises(InputError, match='Effort "push": law must be a function of time t .* or a constant, found'):
        fmbd.effort("push", fmbd.angle(pin), law)


def test_a_mistyped_argument_is_named_with_its_function() -> None:
    body, _ = arm()
    with pytest.raises(
        TypeError, match=r"^ball\(\): .*'centre'. Did you mean \"center\"\? It takes body, radius; by name: center.$"
    ):
        C.ball(body, 0.1, centre=(0, 0))  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (
            lambda: fmbd.RigidBody("b", 1.0, 1.0, angle=0.1),
            r"^RigidBody\(\): .*'angle'. It takes name, mass, .*, shape.$",
        ),
        (lambda: fmbd.RigidBody("b"), r"^RigidBody\(\): missing a required argument: 'mass'. It takes "),
        (lambda: fmbd.Radau(stage=3), r"^Radau\(\): .*'stage'. Did you mean \"stages\"\? It takes stages, "),
        (lambda: fmbd.contacts.HalfSpace((0, 0), (0, 1), depth=1.0), r"^HalfSpace\(\): .*'depth'. It takes "),
        (lambda: fmbd.solve(dropped(), dt=1e-3), r"^solve\(\): .*'t_end'. It takes scene; by name: t_end, dt, "),
        (lambda: fmbd.study.map(lambda x: dropped(), [1], dt=1e-3), r"^study.map\(\): .*'t_end'. It takes "),
        (
            lambda: fmbd.study.map(lambda x: dropped(), [1], t_end=1.0, dtt=1e-3),
            r"'dtt'. Did you mean \"dt\"\? It takes ",
        ),
    ],
)
def test_classes_and_runs_say_what_they_take(make: Callable[[], Any], told: str) -> None:
    with pytest.raises(InputError, match=told) as found:
        make()
    assert isinstance(found.value, TypeError)


def test_messages_name_bodies_and_count_in_words() -> None:
    body, _ = arm()
    with pytest.raises(InputError, match='^Joint "u" is a joint of space; ground and RigidBody "arm" are plane. Use'):
        fmbd.universal("u", fmbd.ground, body, center=(0, 0))
    with pytest.raises(InputError, match="must be a finite number.$"):
        fmbd.torque("turn", body, (0.0, 0.0, 1.0))


def test_what_fails_within_a_call_that_fits_is_raised_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*given: Any) -> None:
        raise TypeError("within")

    monkeypatch.setattr(fmbd.RigidBody, "_check_start", fail)
    with pytest.raises(TypeError, match="^within$"):
        arm()


def test_a_sensor_takes_a_body_by_its_name() -> None:
    scene = dropped()
    scene.sensor("height", fmbd.position("ball", point=(2.0, 0.2)))
    scene.sensor("turn", fmbd.rotation("ball"))
    scene.sensor("spin", fmbd.angular_velocity("ball"))
    run = fmbd.solve(scene, t_end=1e-2, dt=1e-3)
    assert run["height"][0] == pytest.approx([2.0, 0.2]) and run["turn"].shape == run["spin"].shape == (11, 1)
    with pytest.raises(InputError, match='"bal" is not among the bodies of the scene. Did you mean "ball"'):
        scene.sensor("speed", fmbd.velocity("bal"))
    with pytest.raises(InputError, match=r"connects 'ball'; expected .* say scene.bodies\['ball'\]."):
        fmbd.force("push", "ball", (1.0, 0.0))


def dropped() -> Any:
    """A ball above a floor beside a hinged arm."""
    body, pin = arm()
    ball = fmbd.RigidBody("ball", 1.0, 0.1, position=(2.0, 0.15))
    floor = C.Obstacle("floor", C.HalfSpace((0, 0), (0, 1)))
    scene = fmbd.Scene("drop", gravity=(0, -9.81))
    scene.add(body, pin, ball, fmbd.contact("touch", C.ball(ball, 0.1), floor))
    scene.sensor("ball", fmbd.position(ball))
    return scene


def test_fields_of_what_is_made_are_not_set() -> None:
    rod = fmbd.RigidBody("rod", 1.0, 0.1, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, rod, center=(0, 0))
    spring = fmbd.joint_spring("spring", fmbd.angle(pin), stiffness=1.0)
    lasting: list[tuple[Any, str]] = [(rod, "velocity"), (pin, "axis"), (spring, "stiffness")]
    lasting += [
        (fmbd.gear("gear", fmbd.angle(pin), 2 * fmbd.angle(pin), ratio=1.0), "motion"),
        (fmbd.Output(), "every"),
    ]
    lasting += [(fmbd.GeneralizedAlpha(), "rho_inf"), (fmbd.Event("x"), "level")]
    for made, field in lasting:
        with pytest.raises(InputError, match=f"stays as it was made, with its {field}: make another one"):
            setattr(made, field, 1.0)
    with pytest.raises(InputError, match='RigidBody "rod" has no "velocty" to set. Did you mean "velocity"'):
        rod.velocty = (1.0, 0.0)  # type: ignore[attr-defined]
    assert rod.velocity is None


def test_rigid_bodies_that_touch_need_no_scheme() -> None:
    run = fmbd.solve(dropped(), t_end=0.3, dt=1e-3)
    assert run.scheme.name == fmbd.Moreau().name
    assert run["ball"][-1, 1] == pytest.approx(0.1, abs=1e-3)


def test_a_body_that_lies_on_another_is_not_called_loose() -> None:
    assert not [note for note in dropped().check().notes if "attached to nothing" in note]
    scene = dropped()
    scene.add(fmbd.RigidBody("lost", 1.0, 0.1, position=(9.0, 9.0)))
    assert 'body "lost" is attached to nothing' in scene.check().notes


def test_default_scheme_of_elastic_and_reduced_surfaces(rod_mesh: Any) -> None:
    from fmbd_fenicsx.run.settings import default_scheme

    rod = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.5), density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
    for body, wanted in ((rod, fmbd.ContactMidpoint), (rod.reduced(modes=3), fmbd.Moreau)):
        scene = fmbd.Scene("wall")
        wall = C.Obstacle("wall", C.HalfSpace((2, 0), (-1, 0)))
        scene.add(body, fmbd.contact("touch", body.surface("tip"), wall))
        assert isinstance(default_scheme(scene), wanted)


def test_objects_print_as_what_they_are(rod_mesh: Any) -> None:
    mesh = rod_mesh(dim=2, h=0.5)
    assert f"{mesh.dolfinx.topology.index_map(2).size_global} cells in 2D" in repr(mesh)
    assert 'surfaces "pin"' in repr(mesh)
    rod = fmbd.FloatingBody("rod", mesh, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
    model = fmbd.interface_model(rod.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 2)), ("pin", "tip"))
    assert repr(model).startswith("<InterfaceModel of 10 freedoms: interfaces pin, tip; 4 modes")


def test_books_name_each_element_once() -> None:
    """Elements that appear late count as zero before."""
    from fmbd_fenicsx.run.recording.ledger import _columns

    columns = _columns([{"b": 1.0}, {"a": 1.0, "b": 2.0}, {"a": 0.0}])
    assert {name: list(x) for name, x in columns.items()} == {"b": [1.0, 2.0, 0.0], "a": [0.0, 1.0, 0.0]}


def test_an_element_that_did_no_work_has_an_entry() -> None:
    """A stop that was not reached; the joint itself, at rest, has none."""
    body, pin = arm()
    stop = fmbd.elastic_stop("stop", fmbd.angle(pin), upper=1.0, stiffness=100.0)
    scene = fmbd.Scene("arm", gravity=(0, -9.81))
    scene.add(body, pin, stop)
    ledger = fmbd.solve(scene, t_end=0.02, dt=0.01, output=fmbd.Output(ledger=True)).ledger
    assert not ledger["stop"].any() and not ledger.power["stop"].any() and "stop" in str(ledger)
    assert "pin" not in ledger.work


def test_files_that_cannot_be_written_are_named(tmp_path: Any, rod_mesh: Any) -> None:
    body, pin = arm()
    scene = fmbd.Scene("arm")
    scene.add(body, pin)
    scene.sensor("arm", fmbd.position(body))
    run = fmbd.solve(scene, t_end=0.02, dt=0.01, output=fmbd.Output(snapshots=2))
    for file, why in (
        (tmp_path / "none/arm.png", "No such file or directory"),
        (tmp_path / "arm.doc", "not supported"),
    ):
        with pytest.raises(InputError, match=f"cannot be written to .*{file.name}.*{why}"):
            run.plot("arm", file=file)

    rod = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.5), density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
    model = fmbd.interface_model(rod.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 2)), ("pin", "tip"))
    with pytest.raises(InputError, match="The body cannot be written to .*none"):
        model.save(tmp_path / "none/rod.npz")


def test_near_matches_do_not_mind_capitals() -> None:
    from fmbd_fenicsx.errors import near

    assert near("Root", ["TIP", "ROOT"]).startswith('Did you mean "ROOT"?')


def test_sections_tell_the_names_that_they_take() -> None:
    """A constructor from dimensions takes them by name only, and says so."""
    names = "youngs_modulus, poisson_ratio, density, radius, inner"
    with pytest.raises(TypeError, match=rf"^RodSection.circle\(\): too many .*It takes by name: {names}.$"):
        fmbd.RodSection.circle(2e11, 0.3, 7800.0, 0.01)  # type: ignore[misc,call-arg]
    with pytest.raises(InputError, match="Section.rectangle: height 'a' must be a finite number"):
        fmbd.Section.rectangle(youngs_modulus=1.0, poisson_ratio=0.3, density=1.0, width=1.0, height="a")  # type: ignore[arg-type]


def test_adding_returns_the_part() -> None:
    scene = fmbd.Scene("arm", gravity=(0, -9.81))
    body = scene.add(fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0)))
    pin, spring = scene.add(
        fmbd.revolute("pin", fmbd.ground, body, center=(0, 0)),
        fmbd.Spring("spring", fmbd.ground, body, (0, 1), (1, 0), stiffness=10.0),
    )
    assert (body.name, pin.name, spring.name) == ("arm", "pin", "spring")


def test_sensors_of_elements_take_names() -> None:
    """As those of joints and contacts do: the same values and units as from the elements themselves."""
    body, pin = arm()
    motor = fmbd.motor("motor", fmbd.angle(pin), target=0.3, kp=20.0, kd=1.0)
    spring = fmbd.Spring("spring", fmbd.ground, body, (0, -1), (1, 0), stiffness=100.0, length=1.0)
    stop = fmbd.joint_limit("stop", fmbd.angle(pin), lower=-0.05)
    scene = fmbd.Scene("arm", gravity=(0, -9.81))
    scene.add(body, pin, motor, spring, stop)
    kinds = {
        "effort": (fmbd.element_effort, motor),
        "force": (fmbd.element_force, spring),
        "torque": (fmbd.element_torque, motor),
        "power": (fmbd.element_power, motor),
        "tension": (fmbd.tension, spring),
        "elongation": (fmbd.elongation, motor),
        "stop": (fmbd.sensors.limit_effort, stop),
    }
    for name, (make, part) in kinds.items():
        scene.sensor(name, make(part))
        scene.sensor(f"{name} by name", make(part.name))
        assert scene.sensors[name].unit == scene.sensors[f"{name} by name"].unit

    run = fmbd.solve(scene, t_end=0.5, dt=1e-2)
    for name in kinds:
        np.testing.assert_array_equal(run[name], run[f"{name} by name"])
        assert np.abs(run[name]).max() > 0

    scene.sensor("phi", fmbd.angle(pin))
    scene.sensor("phi by name", fmbd.angle("pin"))
    assert scene.sensors["phi by name"].unit == "rad"
    run = fmbd.solve(scene, t_end=0.5, dt=1e-2)
    np.testing.assert_array_equal(run["phi"], run["phi by name"])
    assert np.abs(run["phi"]).max() > 0
    with pytest.raises(InputError, match='Joint "pin" .revolute. has no displacement; .*distance and segment do'):
        scene.sensor("s", fmbd.displacement("pin"))
    with pytest.raises(
        InputError,
        match='coordinate angle or displacement of joint "pin" must be fmbd.angle.* of a joint itself, not of its name',
    ):
        fmbd.drive("drive", fmbd.angle("pin"), lambda t: t)

    # sums of such, and rates
    scene.add(weight := fmbd.RigidBody("weight", 1.0, 0.1, position=(4.0, 0.0)))
    scene.add(elbow := fmbd.revolute("elbow", fmbd.ground, weight, center=(1.0, 0.0)))
    phi, psi = fmbd.angle(pin), fmbd.angle(elbow)
    sums = {
        "both": (2 * phi - psi / 3 + 0.5, 2 * fmbd.angle("pin") - fmbd.angle("elbow") / 3 + 0.5),
        "mixed": (phi - (1.0 - psi), phi - (1.0 - fmbd.angle("elbow"))),
        "rate": (fmbd.joint_rate(psi - phi), fmbd.joint_rate(-fmbd.angle("pin") + psi)),
    }
    for name, (of_joints, of_names) in sums.items():
        scene.sensor(name, of_joints)
        scene.sensor(f"{name} by names", of_names)
        assert scene.sensors[name].unit == scene.sensors[f"{name} by names"].unit
    run = fmbd.solve(scene, t_end=0.5, dt=1e-2)
    for name in sums:
        np.testing.assert_allclose(run[name], run[f"{name} by names"], rtol=0, atol=1e-14)
        assert np.abs(run[name][-1] - run[name][0]).max() > 0.01
    with pytest.raises(InputError, match='Sensor "bad": "pon" is not among the joints .* Did you mean "pin"?'):
        scene.sensor("bad", phi + fmbd.angle("pon"))

    with pytest.raises(AttributeError, match="Run has no attribute 'sereis'; near it: series"):
        _ = run.sereis
    with pytest.raises(InputError, match='Sensor "x": "sprong" is not among the forces .* Did you mean "spring"?'):
        scene.sensor("x", fmbd.tension("sprong"))
    with pytest.raises(InputError, match='"spring" is a name that only scene.sensor'):
        law = fmbd.controller(
            "c", reads={"T": fmbd.tension("spring")}, acts=fmbd.angle(pin), law=lambda t, y, z: 0.0, every=0.1
        )
        scene.add(law)
        fmbd.solve(scene, t_end=0.2, dt=1e-2)


def test_a_rod_is_as_long_as_its_points_are_apart() -> None:
    """A pendulum on a massless rod swings as one of that length."""
    ends = []
    for length in (None, 0.5):
        bob = fmbd.RigidBody("bob", 2.0, 0.1, (0.3, -0.4))
        scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
        scene.add(bob, fmbd.distance("rod", fmbd.ground, bob, length=length))
        scene.sensor("bob", fmbd.position(bob))
        ends.append(fmbd.solve(scene, t_end=0.3, dt=1e-2)["bob"][-1])
    np.testing.assert_array_equal(*ends)

    mesh = fmbd.read_gmsh("meshes/rod.py", h=0.3)
    rod = fmbd.FloatingBody("rod", mesh, density=1e3, elastic=fmbd.materials.linear_elastic(5e6, 0.3))
    with pytest.raises(InputError, match='Joint "wire": give its length, or the point of "tip"'):
        fmbd.distance("wire", fmbd.ground, rod.surface("tip"))
