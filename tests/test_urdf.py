"""Mechanisms from URDF files: a chain against its formula, kinds of joints, one link elastic, named mistakes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError

pytest.importorskip("yourdfpy")

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.25" rpy="0 0 0.3"/><mass value="2"/>
    <inertia ixx="0.045" iyy="0.05" izz="0.01" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.2 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1" rpy="0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/><dynamics damping="0.3" friction="0.1"/></joint>
  <joint name="elbow" type="{kind}"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.5" rpy="0 1.5707963 0"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="flange" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0.4 0 0"/></joint>
</robot>"""


def written(folder: Path, kind: str = "continuous", mass: str = "1") -> Path:
    """The file of an arm."""
    file = folder / "arm.urdf"
    file.write_text(ARM.format(kind=kind, mass=mass))
    return file


def test_placement_elements_and_limits(tmp_path: Path) -> None:
    robot = fmbd.read_urdf(written(tmp_path), start={"shoulder": 0.5, "elbow": -0.2})
    c, s = np.cos(0.5), np.sin(0.5)
    assert np.allclose(robot.frames["fore"][:3, 3], (0.5 * s, 0, 0.1 + 0.5 * c))
    assert np.allclose(robot.bodies["upper"].position, (0.25 * s, 0, 0.1 + 0.25 * c))
    assert robot.joints["shoulder"].limits == (-2.0, 2.0)
    assert robot.carrier["tool"] == "fore"
    assert str(robot).splitlines() == [
        '<Robot "arm" on base: bodies upper, fore; joints',
        "  shoulder: revolute, base - upper",
        "  elbow: continuous, upper - fore",
        "  flange: fixed, fore - tool>",
    ]
    assert "array" not in str(robot.joints)
    scene = robot.scene(gravity=(0, 0, -9.81))
    assert sorted(scene.bodies) == ["fore", "upper"]
    assert sorted(scene.forces) == ["shoulder damping", "shoulder friction"]
    assert scene.check().freedom == 2


def test_motion_equals_the_scene_written_by_hand(tmp_path: Path) -> None:
    robot = fmbd.read_urdf(written(tmp_path))
    scene = robot.scene(gravity=(0, 0, -9.81))
    scene.sensor("elbow", robot.coordinate("elbow"))
    J = np.array([[0.045, 0.001, 0], [0.001, 0.05, 0], [0, 0, 0.01]])
    turn = fmbd.read_urdf(written(tmp_path)).bodies["upper"].rotation
    upper = fmbd.RigidBody("upper", 2.0, J, position=(0, 0, 0.35), rotation=turn)
    fore = fmbd.RigidBody("fore", 1.0, (0.02, 0.02, 0.01), position=(0, 0, 0.4))
    hand = fmbd.Scene("hand", gravity=(0, 0, -9.81))
    first = fmbd.revolute("shoulder", fmbd.ground, upper, center=(0, 0, 0.1), axis=(0, 1, 0))
    second = fmbd.revolute("elbow", upper, fore, center=(0, 0, 0.6), axis=(0, 1, 0))
    hand.add(upper, fore, first, second, fmbd.joint_spring("d", fmbd.angle(first), damping=0.3))
    hand.add(fmbd.joint_friction("f", fmbd.angle(first), coulomb=0.1, speed=1e-2))
    hand.sensor("elbow", fmbd.angle(second))
    for made in (scene, hand):  # away from the dead centre
        made.add(fmbd.torque("push", made.bodies["upper"], lambda t: (0.0, 3.0, 0.0)))
    runs = [fmbd.solve(s, t_end=0.3, dt=5e-3) for s in (scene, hand)]
    assert np.abs(runs[0]["elbow"]).max() > 0.1
    assert np.abs(runs[0]["elbow"] - runs[1]["elbow"]).max() < 1e-6


def test_what_is_left_out_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A start outside of limits, also that of zero, and damping of a joint without a coordinate."""
    fmbd.read_urdf(written(tmp_path), start={"shoulder": 2.0})
    assert not caplog.records
    fmbd.read_urdf(written(tmp_path), start={"shoulder": 2.5})
    assert '"shoulder" at 2.5, limits -2 to 2' in caplog.text
    file = written(tmp_path, kind="planar")
    file.write_text(
        file.read_text().replace('lower="-2"', 'lower="0.1"').replace("</joint>", '<dynamics damping="1"/></joint>')
    )
    caplog.clear()
    fmbd.read_urdf(file)
    assert '"shoulder" at 0, limits 0.1 to 2' in caplog.text
    assert 'left out of joints without one angle or displacement: "elbow" (planar)' in caplog.text


def test_bad_input_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='joint "elbow" is of kind "ball"'):
        fmbd.read_urdf(written(tmp_path, kind="ball"))
    with pytest.raises(InputError, match='link "fore" has no mass but moves by joint "elbow"'):
        fmbd.read_urdf(written(tmp_path, mass="0"))
    with pytest.raises(InputError, match='Did you mean "elbow"'):
        fmbd.read_urdf(written(tmp_path), start={"elbo": 1.0})
    with pytest.raises(InputError, match="there is no file"):
        fmbd.read_urdf(tmp_path / "none.urdf")
    robot = fmbd.read_urdf(written(tmp_path))
    with pytest.raises(InputError, match='no link "for"'):
        robot.make_elastic("for", None, surfaces={})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="give a surface for each"):
        robot.make_elastic("fore", None, surfaces={})  # type: ignore[arg-type]


def test_demo_of_an_arm_with_an_elastic_link(tmp_path: Path) -> None:
    command = [sys.executable, "demos/robot_arm.py", "--fast", "--json", str(tmp_path / "arm.json")]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=280)  # noqa: PLW1510
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert all(check["ok"] for check in json.loads((tmp_path / "arm.json").read_text())["check"])


FINGERS = """<robot name="fingers">
  <link name="hand"/>
  <link name="one"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="two"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="a" type="revolute"><parent link="hand"/><child link="one"/><axis xyz="0 0 2"/></joint>
  <joint name="b" type="revolute"><parent link="hand"/><child link="two"/><origin xyz="0 1 0"/><axis xyz="0 0 1"/>
    <mimic joint="{leader}" multiplier="-1.5" offset="0.2"/></joint>
</robot>"""


def test_a_joint_that_mimics_begins_where_the_other_puts_it(tmp_path: Path) -> None:
    file = tmp_path / "fingers.urdf"
    file.write_text(FINGERS.format(leader="a"))
    for start, place in (({}, 0.2), ({"a": 0.4}, -0.4), ({"a": 0.4, "b": -0.4}, -0.4)):
        frame = fmbd.read_urdf(file, start=start).frames["two"]
        assert np.arctan2(frame[1, 0], frame[0, 0]) == pytest.approx(place, abs=1e-12)
    with pytest.raises(InputError, match='"b" mimics "a", which puts it at -0.4, not at the start 0.1'):
        fmbd.read_urdf(file, start={"a": 0.4, "b": 0.1})
    for leader, said in (("b", "mimic each other in a circle"), ("c", 'mimics "c", which is no joint')):
        file.write_text(FINGERS.format(leader=leader))
        with pytest.raises(InputError, match=said):
            fmbd.read_urdf(file)
    whole = FINGERS.format(leader="a")
    for given, wrong, said in (
        ('name="two"', 'name="one"', r"names of links must be unique, found more than once: \['one'\]"),
        ('joint name="b"', 'joint name="a"', r"names of joints must be unique, found more than once: \['a'\]"),
        ('<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>', "", 'link "one" has a mass without <inertia>'),
        ('<child link="two"/>', '<child link="one"/>', r'link "one" is the child of joints \[.a., .b.\]'),
        ("<robot name=", "<robot title=", "fingers.urdf is no URDF file: KeyError: 'name'"),
        ('ixx="1"', 'ixx="one"', "is no URDF file: ValueError: could not convert string to float: 'one'"),
    ):
        file.write_text(whole.replace(given, wrong, 1))
        with pytest.raises(InputError, match=said):
            fmbd.read_urdf(file)
    for kind in ("fixed", "floating", "planar"):
        file.write_text(whole.replace("revolute", kind, 1))
        with pytest.raises(InputError, match=f'joint "a" of kind "{kind}" has no angle or displacement to start with'):
            fmbd.read_urdf(file, start={"a": 0.3})
    file.write_text(FINGERS[:300])
    with pytest.raises(InputError, match="no complete XML file"):
        fmbd.read_urdf(file)


def test_coordinates_count_as_the_file_does(tmp_path: Path) -> None:
    """An arm that falls from 1.8 rad rests at its limit of 2 rad, on a rigid stop as on one that gives way."""
    for kind in (fmbd.joint_limit, fmbd.elastic_stop):
        robot = fmbd.read_urdf(written(tmp_path), start={"shoulder": 1.8, "elbow": 0.3})
        scene = robot.scene(gravity=(0, 0, -9.81))
        lower, upper = robot.joints["shoulder"].limits
        more = {} if kind is fmbd.joint_limit else {"stiffness": 1e5, "damping": 1e3}
        scene.add(kind("stop", robot.coordinate("shoulder"), lower=lower, upper=upper, **more))
        scene.sensor("shoulder", robot.coordinate("shoulder"))
        run = fmbd.solve(scene, t_end=0.5, dt=2e-3)
        assert run["shoulder"][0] == pytest.approx(1.8, abs=1e-12)
        assert run["shoulder"][-1] == pytest.approx(2.0, abs=1e-3)
