"""What a record costs: every kind of sensor on every kind of body, CPU time over that of steps without records.

Run:  ./with-dolfinx python3 tests/benchmarks/recording.py [--body WORD] [--sensor WORD] [--repeat 3]

A rod on a hinge with a joint spring, generalized-alpha, h = 1e-4 s. Each figure is the median of differences of whole runs of N
and 2 N steps, without records, with records of energies alone and with one sensor more.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from combinations import BODIES, Hung, pinned  # noqa: E402
from ufl import div, grad, inner, sym  # noqa: E402

import fmbd_fenicsx as fmbd  # noqa: E402
from fmbd_fenicsx import sensors  # noqa: E402
from fmbd_fenicsx.errors import FmbdError  # noqa: E402
from fmbd_fenicsx.system.sensors.sensor import Sensor  # noqa: E402

STEP = 1e-4  # s
SHORTEST, MOST = 0.05, 20_000  # s of CPU time that N steps should take, and the most of these


def in_space():
    """A rigid rod in space."""
    body = fmbd.RigidBody("rod", 100.0, (1.0, 9.0, 9.0), position=(0.5, 0.0, 0.0))
    return Hung(body, body, body)


KINDS = {"rigid": BODIES["rigid"], "space": in_space} | {
    k: BODIES[k] for k in ("reduced", "floating", "absolute", "large strain", "beam", "rod")
}


@dataclass(frozen=True, eq=False)
class Own(Sensor):
    """A sensor of the user's own: the kinetic energy of the tip's motion, by its own read()."""

    def read(self, ev, state, marker):
        return np.array([ev.kin.twist[marker] @ ev.kin.twist[marker]])


def _at(rod):
    return {"point": rod.at(1.0, 0.0)} if isinstance(rod.body, fmbd.RigidBody) else {}


def _energy(u):
    return inner(sym(grad(u)), sym(grad(u))) + div(u) ** 2


def five(rod, pin, spring):
    """The five sensors of docs/performance.md."""
    return {
        "position": sensors.position(rod.tip, **_at(rod)),
        "velocity": sensors.velocity(rod.tip, **_at(rod)),
        "angle": sensors.angle(pin),
        "reaction": sensors.reaction_force(pin),
        "rotation": sensors.rotation(rod.tip),
    }


SENSORS = {
    "five": five,
    "position": lambda rod, pin, spring: sensors.position(rod.tip, **_at(rod)),
    "velocity": lambda rod, pin, spring: sensors.velocity(rod.tip, **_at(rod)),
    "acceleration": lambda rod, pin, spring: sensors.acceleration(rod.tip, **_at(rod)),
    "rotation": lambda rod, pin, spring: sensors.rotation(rod.tip),
    "angular velocity": lambda rod, pin, spring: sensors.angular_velocity(rod.tip),
    "angle": lambda rod, pin, spring: sensors.angle(pin),
    "joint rate": lambda rod, pin, spring: sensors.joint_rate(sensors.angle(pin)),
    "reaction": lambda rod, pin, spring: sensors.reaction(pin),
    "reaction force": lambda rod, pin, spring: sensors.reaction_force(pin),
    "element effort": lambda rod, pin, spring: sensors.element_effort(spring),
    "element torque": lambda rod, pin, spring: sensors.element_torque(spring),
    "element power": lambda rod, pin, spring: sensors.element_power(spring),
    "coordinates": lambda rod, pin, spring: sensors.coordinates(rod.body),
    "material point": lambda rod, pin, spring: sensors.position(rod.body, point=(0.6, 0.02)),
    "its velocity": lambda rod, pin, spring: sensors.velocity(rod.body, point=(0.6, 0.02)),
    "its acceleration": lambda rod, pin, spring: sensors.acceleration(rod.body, point=(0.6, 0.02)),
    "displacement": lambda rod, pin, spring: sensors.elastic_displacement(rod.body, point=(0.6, 0.02)),
    "strain": lambda rod, pin, spring: sensors.strain(rod.body, point=(0.6, 0.02)),
    "point value": lambda rod, pin, spring: sensors.point_value(rod.body, _energy, point=(0.6, 0.02)),
    "largest": lambda rod, pin, spring: sensors.largest(rod.body, _energy),
    "section forces": lambda rod, pin, spring: sensors.section_forces(rod.left),
    "section strains": lambda rod, pin, spring: sensors.section_strains(rod.left),
    "own": lambda rod, pin, spring: Own(rod.tip, "J", _at(rod).get("point")),
}


def scene_of(body, sensor):
    """The rod with one sensor, or none; None where the body has no such."""
    rod = KINDS[body]()
    scene = fmbd.Scene(f"{body}, {sensor}", gravity=rod.at(0, -9.81))
    scene.add(rod.body)
    pin = pinned(scene, rod)
    spring = fmbd.joint_spring("spring", fmbd.angle(pin), stiffness=100.0, damping=1.0)
    scene.add(spring)
    if sensor:
        made = SENSORS[sensor](rod, pin, spring)
        for name, one in (made if isinstance(made, dict) else {sensor: made}).items():
            scene.sensor(name, one)
    return scene


def spent(body, sensor, steps):
    """CPU seconds of a run with every step recorded; ``sensor`` None: without records."""
    scene = scene_of(body, sensor)
    output = fmbd.Output(every=10**9 if sensor is None else 1, progress=False)
    begin = time.process_time()
    fmbd.solve(scene, t_end=steps * STEP, dt=STEP, output=output)
    return time.process_time() - begin


def step_of(body, sensor, steps):
    """Microseconds a step."""
    return (spent(body, sensor, 2 * steps) - spent(body, sensor, steps)) / steps * 1e6


def steps_for(body, sensor):
    """Steps that take long enough."""
    steps = 50
    while steps < MOST:
        one = step_of(body, sensor, steps) * steps * 1e-6
        if one > SHORTEST / 2:
            break
        steps = min(MOST, int(steps * min(max(SHORTEST / max(one, 1e-3), 2.0), 16.0)))
    return steps


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--body", default="")
    parser.add_argument("--sensor", default="")
    parser.add_argument("--repeat", type=int, default=3)
    given = parser.parse_args()

    for body in (b for b in KINDS if given.body in b):
        step_of(body, "five", 50)  # kernels are made
        without = [step_of(body, None, steps_for(body, None)) for _ in range(given.repeat)]
        plain = [step_of(body, "", steps_for(body, "")) for _ in range(given.repeat)]
        base, energy = float(np.median(without)), float(np.median(plain))
        print(f"{body}: {base:.2f} us a step, {energy - base:+.2f} us with energies", flush=True)
        for sensor in (s for s in SENSORS if given.sensor in s):
            try:
                steps = steps_for(body, sensor)
            except (FmbdError, AttributeError, TypeError, StopIteration):
                continue
            found = float(np.median([step_of(body, sensor, steps) for _ in range(given.repeat)]))
            print(f"    {sensor:18s} {found - energy:+8.2f} us a record, {found / base:6.2f} of a step", flush=True)


if __name__ == "__main__":
    main()
