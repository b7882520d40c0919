"""FMI 3.0 units: validated and run by FMPy, steps repeated and rejected, half a mechanism coupled with its other half."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.run.co_simulation import Unit

MASS, OTHER, WALL, LINK = 1.5, 0.8, 30.0, 12.0  # kg, kg, N/m, N/m
HALF = f"""
import fmbd_fenicsx as fmbd

def scene():
    cart = fmbd.RigidBody("cart", {MASS}, 1.0)
    made = fmbd.Scene("half")
    rail = fmbd.prismatic("rail", fmbd.ground, cart, axis=(1, 0), center=(0, 0))
    s = fmbd.displacement(rail)
    made.add(cart, rail, fmbd.joint_spring("wall", s, stiffness={WALL}))
    made.add(fmbd.effort("push", s, made.input("force", 0.0, lower=-100, upper=100)))
    made.sensor("x", s)
    made.sensor("place", fmbd.position(cart))
    return made
"""


def other() -> fmbd.Scene:
    """The other half: a cart; the force of the link comes from outside."""
    cart = fmbd.RigidBody("cart", OTHER, 1.0)
    made = fmbd.Scene("other")
    rail = fmbd.prismatic("rail", fmbd.ground, cart, axis=(1, 0), center=(0, 0))
    s = fmbd.displacement(rail)
    made.add(cart, rail, fmbd.effort("push", s, made.input("force", 0.0)))
    made.sensor("x", s)
    return made


def whole() -> float:
    """Position of the first cart at t = 1 s with both in one model, exact."""
    from scipy.linalg import expm

    M, K = np.diag((MASS, OTHER)), np.array([[WALL + LINK, -LINK], [-LINK, LINK]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), np.zeros((2, 2))]])
    load = np.linalg.solve(M, np.array([-LINK, LINK]) * 0.5)  # the link is free at x_2 - x_1 = 0.5
    Z = np.block([[A, np.concatenate((np.zeros(2), load))[:, None]], [np.zeros((1, 5))]])
    return float(expm(Z)[0, 4])


def couple(first: Any, second: Any, steps: int) -> float:
    """Both halves over 1 s: each step repeated until the mean force of the link in it does not change."""
    H = 1.0 / steps
    link = lambda: LINK * (second.get("x") - first.get("x") - 0.5)  # noqa: E731
    for k in range(steps):
        marks, start = (first.save(), second.save()), link()
        force = start
        for _ in range(30):
            first.restore(marks[0])
            second.restore(marks[1])
            first.set("force", force)
            second.set("force", -force)
            first.do_step(k * H, H)
            second.do_step(k * H, H)
            before, force = force, 0.5 * (start + link())
            if abs(force - before) < 1e-9:
                break
    return first.get("x")


def test_two_halves_converge_to_the_whole() -> None:
    errors = []
    for steps in (10, 20):
        halves = Unit(lambda: _scene(HALF), dt=2.5e-3), Unit(other, dt=2.5e-3)
        errors.append(abs(couple(*halves, steps) - whole()))
        for half in halves:
            half.close()
    assert errors[1] < 2e-3
    assert errors[0] / errors[1] > 3.0, "second order in the communication step"


def _scene(text: str) -> fmbd.Scene:
    names: dict[str, Any] = {}
    exec(text, names)
    return names["scene"]()


def test_a_step_from_elsewhere_is_refused() -> None:
    unit = Unit(lambda: _scene(HALF), dt=1e-2)
    unit.do_step(0.0, 0.1)
    with pytest.raises(fmbd.errors.FmbdError, match=r"stands at t = 0.1 s"):
        unit.do_step(0.3, 0.1)
    assert sorted(unit.outputs) == ["place_x", "place_y", "x"]
    unit.close()


class Remote:
    """A unit through FMPy: FMI calls only."""

    def __init__(self, file: Path) -> None:
        from fmpy import extract, read_model_description
        from fmpy.fmi3 import FMU3Slave

        about = read_model_description(str(file))
        self.refs = {v.name: v.valueReference for v in about.modelVariables}
        self.unit = FMU3Slave(
            guid=about.guid, unzipDirectory=extract(str(file)), modelIdentifier=about.coSimulation.modelIdentifier
        )
        self.unit.instantiate()
        self.unit.enterInitializationMode(startTime=0.0)
        self.unit.exitInitializationMode()

    def get(self, name: str) -> float:
        """An output."""
        return float(self.unit.getFloat64([self.refs[name]])[0])

    def set(self, name: str, value: float) -> None:
        """An input."""
        self.unit.setFloat64([self.refs[name]], [value])

    def do_step(self, t: float, h: float) -> None:
        """One communication step."""
        self.unit.doStep(currentCommunicationPoint=t, communicationStepSize=h)

    def save(self) -> Any:
        """State of the unit."""
        return self.unit.getFMUState()

    def restore(self, state: Any) -> None:
        """Go back."""
        self.unit.setFMUState(state)


def test_unit_of_fmi(tmp_path: Path) -> None:
    """Written, validated, coupled with rejected steps; equal to the unit without FMI to the last bit; range kept."""
    pytest.importorskip("pythonfmu3")
    fmpy = pytest.importorskip("fmpy")
    pytest.importorskip("lark")
    from fmpy.validation import validate_fmu

    script = tmp_path / "half.py"
    script.write_text(HALF)
    file = fmbd.write_fmu(script, tmp_path / "out", dt=2.5e-3)
    assert file.name == "Half.fmu"
    assert validate_fmu(str(file)) == []
    about = fmpy.read_model_description(str(file))
    assert about.fmiVersion == "3.0"
    assert about.coSimulation.canGetAndSetFMUstate
    remote, near, far = Remote(file), Unit(other, dt=2.5e-3), Unit(other, dt=2.5e-3)
    local = Unit(lambda: _scene(HALF), dt=2.5e-3)
    assert couple(remote, near, 10) == couple(local, far, 10)
    _refuses_and_lives_on(remote, fmpy.fmi1.FMICallException, about)
    for half in (near, far, local):
        half.close()


def _refuses_and_lives_on(remote: Remote, error: type[Exception], about: Any) -> None:
    """An input out of range, and a step from elsewhere: the call fails, and the unit goes on as if it had not been made."""
    at, kept = remote.save(), remote.get("force")
    for bad in (101.0, -200.0, float("nan"), float("inf")):
        with pytest.raises(error):
            remote.set("force", bad)
        assert remote.get("force") == kept
    with pytest.raises(error, match="discard"):
        remote.do_step(0.2, 0.1)
    remote.do_step(1.0, 0.1)
    after = remote.get("x")
    remote.restore(at)
    remote.do_step(1.0, 0.1)
    assert remote.get("x") == after != 0.0

    # masters that look find the range before
    ends = [(v.min, v.max) for v in about.typeDefinitions]
    assert [tuple(map(float, pair)) for pair in ends] == [(-100.0, 100.0)]


def test_names_that_a_unit_would_have_twice_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu3")
    script = tmp_path / "twice.py"
    script.write_text(HALF.replace('"x"', '"force"'))
    with pytest.raises(InputError, match='found twice: "force"'):
        fmbd.write_fmu(script, tmp_path, dt=1e-2)


def test_bad_input_is_named(tmp_path: Path) -> None:
    (tmp_path / "torn.py").write_text("def scene(:\n")
    with pytest.raises(fmbd.errors.InputError, match='Script ".*torn.py" failed: SyntaxError: .*line 1'):
        fmbd.write_fmu(tmp_path / "torn.py", tmp_path / "out", dt=1e-3)
    pytest.importorskip("pythonfmu3")
    with pytest.raises(InputError, match="there is no script"):
        fmbd.write_fmu(tmp_path / "none.py", tmp_path, dt=1e-2)
    empty = tmp_path / "empty.py"
    empty.write_text("x = 1\n")
    with pytest.raises(InputError, match="has no function scene"):
        fmbd.write_fmu(empty, tmp_path, dt=1e-2)
