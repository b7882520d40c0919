"""The examples of docs/contributing.md work as printed."""

import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_output import pendulum

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import study

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs/contributing.md").read_text()


def example(word, *, lines=28, **known):
    """The names that the Python block with a word defines, in the presence of others; it is short."""
    block = next(b for b in re.findall(r"```python\n(.*?)```", TEXT, re.S) if word in b)
    assert len([line for line in block.splitlines() if line.strip()]) <= lines
    found = {"__name__": __name__, **known}
    exec(compile(block, "contributing.md", "exec"), found)
    return found


def test_joint_leaves_one_translation_and_two_rotations():
    joint = example("slotted_pin")["slotted_pin"]
    body = fmbd.RigidBody(
        "b", 2.0, (0.2, 0.3, 0.4), position=(0.1, 0.4, 0), velocity=(1, 0, 0), angular_velocity=(0, 0.5, 0.5)
    )
    scene = fmbd.Scene("slot", gravity=(3.0, -9.81, 2.0))
    scene.add(body, joint("slot", fmbd.ground, body, center=np.zeros(3), axis=(1, 0, 0)))
    scene.sensor("pin", fmbd.position(body, point=(0, 0, 0)))
    scene.sensor("rotation", fmbd.rotation(body))
    run = fmbd.solve(scene, t_end=0.2, dt=0.01)
    assert abs(run["pin"][-1, 0]) > 0.1 and np.abs(run["pin"][:, 1:]).max() < 1e-10
    R = run["rotation"][-1].reshape(3, 3)
    assert run.system.n_lam == 3 and np.abs(R - np.eye(3)).max() > 0.01


def test_balls_come_to_rest_on_a_shape():
    capsule = example("Capsule")["Capsule"]((-1.0, 0.0), (1.0, 0.0), 0.2)
    scene = fmbd.Scene("landing", gravity=(0.0, -9.81))
    for name, x in (("inside", 0.3), ("beside", 1.4)):
        body = fmbd.RigidBody(name, 1.0, 0.01, (x, 0.4))
        scene.add(body, fmbd.contact(name, fmbd.ball(body, 0.1), fmbd.Obstacle(f"bar {name}", capsule)))
        scene.sensor(name, fmbd.position(body))
    run = fmbd.solve(scene, t_end=0.5, dt=2e-3)
    assert run["inside"][-1] == pytest.approx((0.3, 0.3), abs=1e-5)
    assert run["beside"][-1, 1] == pytest.approx(0.4 - 0.5 * 9.81 * 0.25, abs=1e-4)  # it falls past the end


@pytest.mark.mpi
def test_weak_form_stiffens_the_rod(rod_mesh):
    def tip(form):
        rod = fmbd.FloatingBody("rod", rod_mesh(), degree=1, density=1e3, elastic=form)
        scene = fmbd.Scene("swing", gravity=(0, -9.81))
        scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        run = fmbd.solve(scene, t_end=0.1, dt=0.01)
        return run.energy["elastic"].max()

    assert tip(example("fibres")["fibres"](5e6, 0.3, 5e7)) < 0.5 * tip(fmbd.materials.linear_elastic(5e6, 0.3))


def test_scheme_has_its_order():
    scheme = example("ProjectedEuler")["ProjectedEuler"]()
    reference = fmbd.solve(pendulum(), t_end=0.48, dt=5e-4)
    table = study.orders(
        lambda h: fmbd.solve(pendulum(), t_end=0.48, dt=h, scheme=scheme),
        [8e-3, 4e-3, 2e-3],
        reference=reference,
    )
    for name in ("q", "v", "lam"):
        table.assert_order(name, 1.0, 0.15)


def test_constraint_by_a_formula():
    bead = fmbd.RigidBody("bead", 0.7, (0.1, 0.1, 0.1), position=(0.6, 0.0, 0.18), velocity=(0.0, 1.1, 0.0))
    scene = fmbd.Scene("bowl", gravity=(0, 0, -9.81))
    scene.add(bead)
    example("bowl", lines=5, fmbd=fmbd, scene=scene, bead=bead)
    scene.sensor("bead", fmbd.position(bead))
    run = fmbd.solve(scene, t_end=0.2, dt=5e-3)
    x, y, z = run["bead"].T
    assert np.abs(z - 0.5 * (x * x + y * y)).max() < 1e-9 and np.ptp(x) > 0.01


def test_force_element_by_a_formula():
    needle = fmbd.RigidBody("needle", 0.01, (1e-6, 1e-5, 1e-5), position=(0.1, 0.0, 0.0), angular_velocity=(0, 0, 1.0))
    scene = fmbd.Scene("magnets")
    scene.add(needle, fmbd.spherical("tip", fmbd.ground, needle, center=(0.1, 0, 0)))
    example("magnets", lines=6, fmbd=fmbd, np=np, scene=scene, needle=needle)
    run = fmbd.solve(scene, t_end=0.02, dt=1e-4)
    total = run.energy["kinetic"] + run.energy["springs"]
    assert np.ptp(total) < 1e-3 * np.ptp(run.energy["kinetic"]) and np.ptp(run.energy["springs"]) > 0


# -- a body of one's own --------------------------------------------------------------------------------------------------
J, AXIS, WHEEL, MOTOR, SPEED = np.array([0.2, 0.3, 0.4]), np.array([0.0, 0.6, 0.8]), 0.05, 0.3, 40.0
MASS, ARM, START = 2.0, np.array([0.3, 0.0, 0.0]), np.array([0.4, -0.2, 1.0])


def gyrostat(pinned):
    """A spinning body with a wheel, free or held at a point (START: its angular velocity)."""
    made = example("Gyrostat", lines=60)["Gyrostat"]
    wheel = {"axis": tuple(AXIS), "wheel": WHEEL, "motor": MOTOR, "speed": SPEED}
    velocity = tuple(np.cross(START, ARM)) if pinned else None
    body = made("body", MASS, tuple(J), tuple(ARM), velocity=velocity, angular_velocity=tuple(START), **wheel)
    scene = fmbd.Scene("gyrostat", gravity=(0, -9.81, 0) if pinned else None)
    scene.add(body)
    if pinned:
        scene.add(fmbd.spherical("pin", fmbd.ground, body, center=(0, 0, 0)))
    scene.sensor("rotation", fmbd.rotation(body))
    scene.sensor("wheel", fmbd.coordinates("body"))
    return scene


def exact(t_end, pinned):
    """Rotation and wheel angle from Euler's equations about the pin, in body axes."""
    inertia = np.diag(J) + pinned * MASS * (ARM @ ARM * np.eye(3) - np.outer(ARM, ARM))
    matrix = np.block([[inertia, WHEEL * AXIS[:, None]], [WHEEL * AXIS[None], np.array([[WHEEL]])]])

    def rates(t, y):
        R, w, speed = y[:9].reshape(3, 3), y[9:12], y[13]
        weight = pinned * MASS * np.cross(ARM, R.T @ np.array([0.0, -9.81, 0.0]))
        moment = weight - np.cross(w, inertia @ w + WHEEL * AXIS * speed)
        second = np.linalg.solve(matrix, np.append(moment, MOTOR))
        spin = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate(((R @ spin).ravel(), second[:3], [speed, second[3]]))

    start = np.concatenate((np.eye(3).ravel(), START, [0.0, SPEED]))
    y = solve_ivp(rates, (0, t_end), start, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    return y[:9], y[12]


@pytest.mark.mpi
@pytest.mark.parametrize("pinned", [False, True])
def test_own_body_follows_eulers_equations(pinned):
    rotation, angle = exact(0.12, pinned)
    runs = {
        "Radau": fmbd.solve(gyrostat(pinned), t_end=0.12, scheme=fmbd.Radau(rtol=1e-8, atol=1e-8)),
        "fine": fmbd.solve(gyrostat(pinned), t_end=0.12, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8)),
        "coarse": fmbd.solve(gyrostat(pinned), t_end=0.12, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.8)),
    }
    missed = {k: np.abs(run["rotation"][-1] - rotation).max() for k, run in runs.items()}
    assert missed["Radau"] < 1e-5 and abs(runs["Radau"]["wheel"][-1, 0] - angle) < 1e-4
    assert missed["fine"] < 2e-3 and np.log2(missed["coarse"] / missed["fine"]) > 1.8


@pytest.mark.mpi
def test_own_body_is_taken_up_from_a_checkpoint(shared_tmp):
    whole = fmbd.solve(gyrostat(True), t_end=0.04, dt=2e-3)
    fmbd.solve(gyrostat(True), t_end=0.02, dt=2e-3, checkpoint=fmbd.Checkpoint(shared_tmp / "half", every=10))
    taken = fmbd.solve(gyrostat(True), t_end=0.04, dt=2e-3, restart=shared_tmp / "half")
    assert np.array_equal(taken.state.q, whole.state.q)
    assert np.array_equal(taken["wheel"], whole["wheel"])


def test_books_of_an_own_body_balance():
    run = fmbd.solve(gyrostat(False), t_end=0.2, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.95))
    work = MOTOR * run["wheel"][-1, 0]
    assert run.energy["kinetic"][-1] - run.energy["kinetic"][0] == pytest.approx(work, rel=1e-3)


def test_scheme_writes_checkpoints_and_reports(tmp_path):
    scheme = example("ProjectedEuler")["ProjectedEuler"]()
    whole = fmbd.solve(pendulum(), t_end=0.04, dt=2e-3, scheme=scheme)
    fmbd.solve(pendulum(), t_end=0.02, dt=2e-3, scheme=scheme, checkpoint=fmbd.Checkpoint(tmp_path / "half", every=10))
    taken = fmbd.solve(pendulum(), t_end=0.04, dt=2e-3, scheme=scheme, restart=tmp_path / "half")
    assert np.array_equal(taken.state.q, whole.state.q)
    assert "projected Euler" in whole.report()


# -- the walks through the code ---------------------------------------------------------------------------------------------
FLOORS = ["fem", "mechanics", "system", "linear", "schemes", "run", "post"]
SOURCE = Path(fmbd.__file__).parent
WALKS = re.split(r"\n(?=\d\. |\*\*|#)", TEXT[TEXT.index("### Walks") : TEXT.index("Where a walk still looks")])


def stations(walk):
    """Names with a path in a line of a walk: (path, names within)."""
    found = re.findall(r"`((?:[a-z_]+/)+[a-z_]+)\.([A-Za-z_.]+)`", walk)
    return [(path, names.split(".")) for path, names in found]


def test_the_map_names_every_folder():
    named = set(re.findall(r"`(?:\w+/)*(\w+)/`", TEXT[TEXT.index("| floor |") : TEXT.index("### Walks")]))
    folders = {
        path.parent.name for path in (ROOT / "fmbd_fenicsx").rglob("*.[pch]*") if "__pycache__" not in path.parts
    }
    assert folders - {"fmbd_fenicsx"} == named


def test_walks_name_what_is_there():
    steps = [station for walk in WALKS for station in stations(walk)]
    assert len(steps) > 40
    for path, names in steps:
        found = import_module("fmbd_fenicsx." + path.replace("/", "."))
        for name in names:
            assert hasattr(found, name), (path, names)
            found = getattr(found, name)

    in_c = re.findall(r"`([\w/]+\.c):(\w+)`", TEXT)
    assert len(in_c) > 8
    for file, name in in_c:
        text = (SOURCE / "system/compiled/driver" / file).read_text()
        assert re.search(rf"^(?:static|EXPORT|int|double|void)[\w *]*\b{name}\(", text, re.M), (file, name)


def test_walks_go_down():
    for walk in WALKS:
        for chain in re.split(r"[.;:]\s", walk):
            floors = [FLOORS.index(path.split("/")[0]) for path, _ in stations(chain)]
            assert floors == sorted(floors, reverse=True), chain


def test_rooms_of_the_house_are_there():
    house = TEXT[TEXT.index("| floor |") : TEXT.index("### Walks")]
    for folder, rooms in re.findall(r"^\| \d \| `([a-z]+)/` \| (.*) \|$", house, re.M):
        for room in re.findall(r"`([a-z_]+)/?`", rooms):
            assert (SOURCE / folder / room).is_dir() or (SOURCE / folder / f"{room}.py").is_file(), (folder, room)


def test_sensor_gives_all_records_at_once(monkeypatch):
    from fmbd_fenicsx.run.recording.recorder import Recorder

    monkeypatch.setattr(Recorder, "_one_by_one", lambda *args: pytest.fail("a state was read by itself"))
    scene = pendulum()
    scene.sensor("speed", example("Speed")["Speed"](scene.bodies["bob"], "m/s", (1.0, 0.0)))
    scene.sensor("v", fmbd.velocity(scene.bodies["bob"], point=(1.0, 0.0)))
    run = fmbd.solve(scene, t_end=0.2, dt=0.01)
    assert run["speed"][:, 0] == pytest.approx(np.linalg.norm(run["v"], axis=1)) and run["speed"].max() > 1
