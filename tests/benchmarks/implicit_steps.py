"""Steps of Radau and BDF: calls of Python, CPU time, increments and tangents a step, by differences of runs of N and 2 N steps.

Run:  ./with-dolfinx python3 tests/benchmarks/implicit_steps.py                 (all scenes, constant steps and own ones)
      ./with-dolfinx python3 tests/benchmarks/implicit_steps.py --growth        (CPU time a step over the length of a chain)

Calls do not scatter; CPU times are the least of three differences.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2] / "demos"), str(Path(__file__).parents[1])]
STEP = 1e-3


def chain(dim: int, n: int) -> fmbd.Scene:
    """Links of 0.1 m, in space with hinges in turn about y and a skew axis."""
    scene = fmbd.Scene("chain", gravity=(0.0, -9.81) if dim == 2 else (0.0, 0.0, -9.81))
    before: Any = fmbd.ground
    for i in range(n):
        inertia = 1e-3 / 12 if dim == 2 else np.diag([2e-6, 1e-3 / 12, 1e-3 / 12])
        link = fmbd.RigidBody(f"link {i}", 0.1, inertia, [(i + 0.5) * 0.1, 0.0, 0.0][:dim])
        turn: Any = {} if dim == 2 else {"axis": (0.0, 1.0, 0.0) if i % 2 == 0 else (0.0, 0.8, 0.6)}
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=[i * 0.1, 0.0, 0.0][:dim], **turn)
        scene.add(link, hinge)
        before = link
    return scene


def springs() -> fmbd.Scene:
    """A body in space on four spring-dampers."""
    scene = fmbd.Scene("springs", gravity=(0.0, 0.0, -9.81))
    body = fmbd.RigidBody("body", 4.0, np.diag([0.017, 0.017, 0.027]), (0.0, 0.0, 0.0), velocity=(0.3, 0.1, 0.0))
    scene.add(body)
    for i, (x, y) in enumerate(((-0.1, -0.1), (-0.1, 0.1), (0.1, -0.1), (0.1, 0.1))):
        ends = (1.5 * x, 1.5 * y, -0.3), (x, y, -0.05)
        scene.add(fmbd.Spring(f"leg {i}", fmbd.ground, body, *ends, stiffness=3e3, damping=6.0, length=0.26))
    return scene


def crank() -> fmbd.Scene:
    """A slider crank whose rod is a reduced body of four modes."""
    from combinations import reduced

    rod, scene = reduced(), fmbd.Scene("crank", gravity=(0.0, -9.81))
    wheel = fmbd.RigidBody("crank", 30.0, 0.5, (-0.15, 0.0), angular_velocity=3.0, velocity=(0.0, 0.45))
    slider = fmbd.RigidBody("slider", 10.0, 0.1, (1.0, 0.0))
    scene.add(wheel, rod.body, slider)
    scene.add(fmbd.revolute("main", fmbd.ground, wheel, center=(-0.3, 0.0)))
    scene.add(fmbd.revolute("big end", wheel, rod.left, center=(0.0, 0.0)))
    scene.add(fmbd.revolute("small end", rod.tip, slider, center=(1.0, 0.0)))
    scene.add(fmbd.prismatic("guide", fmbd.ground, slider, axis=(1.0, 0.0), center=(1.0, 0.0)))
    return scene


def suspension() -> fmbd.Scene:
    """A double wishbone with a spring-damper, shaken by a force of time."""
    from user_models import suspension as model

    return model().ours()[0]


def andrews() -> fmbd.Scene:
    """Andrews' mechanism of seven bodies."""
    from mechanisms_of_bodies import andrews as scene

    return scene()


def andrews_coordinates() -> fmbd.Scene:
    """The same in seven coordinates, laws in Python."""
    from andrews_model import scene

    return scene()


def car_axis() -> fmbd.Scene:
    """The car axis of the IVP test set, laws in Python."""
    from car_axis import scene

    return scene()


@dataclass(frozen=True)
class Case:
    """A scene, its constant step (s), and what it is stepped by under error control (s)."""

    make: Callable[[], fmbd.Scene]
    step: float = STEP
    span: float = 1.0


CASES = {
    "chain of 10 links, plane": Case(lambda: chain(2, 10)),
    "the same in space": Case(lambda: chain(3, 10)),
    "slider crank, reduced rod": Case(crank),
    "body on four spring-dampers": Case(springs),
    "wheel suspension": Case(suspension),
    "Andrews' mechanism": Case(andrews, 1e-5, 0.03),
    "the same, laws in Python": Case(andrews_coordinates, 1e-5, 0.03),
    "car axis, laws in Python": Case(car_axis, 1e-3, 1.0),
}
SCHEMES: dict[str, Callable[[float | None], Any]] = {
    "BDF": lambda rtol: fmbd.BDF(order=2, rtol=None) if rtol is None else fmbd.BDF(rtol=rtol),
    "Radau": lambda rtol: fmbd.Radau(rtol=rtol),
}
COUNTED = ("steps", "newton_iterations", "jacobians")


@dataclass(frozen=True)
class Cost:
    """Of a run: CPU time (s) or calls of Python, and the counters of :data:`COUNTED`."""

    spent: float
    work: np.ndarray


def cost(case: Case, scheme: Any, steps: int, *, calls: bool) -> Cost:
    """Of a run of so many steps, or of as many hundredths of the span where the scheme chooses its steps."""
    scene, count = case.make(), [0]
    chosen = scheme.rtol is not None
    until = {"t_end": case.span * steps / 100} if chosen else {"t_end": case.step * steps, "dt": case.step}

    def entered(frame: Any, event: str, arg: Any) -> None:
        count[0] += event == "call"

    sys.setprofile(entered if calls else None)
    began = time.process_time()
    try:
        run = fmbd.solve(scene, scheme=scheme, output=fmbd.Output(every=10**9) if not chosen else None, **until)
    finally:
        sys.setprofile(None)
    spent = time.process_time() - began
    work = np.array([run.counters[name] for name in COUNTED])
    return Cost(count[0] if calls else spent, work)


def of_a_step(case: Case, scheme: Any, steps: int, repeat: int) -> tuple[float, float, np.ndarray]:
    """Calls of Python, CPU time (s) and work, by differences of runs of N and 2 N steps."""
    cost(case, scheme, 2, calls=False)
    once, twice = (cost(case, scheme, k, calls=True) for k in (steps, 2 * steps))
    work = twice.work - once.work
    count = work[0]
    times = [
        cost(case, scheme, 2 * steps, calls=False).spent - cost(case, scheme, steps, calls=False).spent
        for _ in range(repeat)
    ]
    return (twice.spent - once.spent) / count, min(times) / count, work / count


def table(steps: int, repeat: int) -> None:
    """All scenes with both schemes."""
    print("| scene | scheme | calls | us | increments | tangents |\n|---|---|---|---|---|---|")
    for name, case in CASES.items():
        for scheme, make in SCHEMES.items():
            for rtol in (None, 1e-6):
                calls, spent, work = of_a_step(case, make(rtol), steps, repeat)
                sort = "constant" if rtol is None else f"rtol {rtol:.0e}"
                print(
                    f"| {name} | {scheme}, {sort} | {calls:.0f} | {1e6 * spent:.0f} | {work[1]:.1f} | {work[2]:.2f} |",
                    flush=True,
                )


def growth(lengths: tuple[int, ...], repeat: int) -> None:
    """CPU time a step of chains over their lengths, constant steps."""
    print("| chain | scheme | links | ms | increments | tangents |\n|---|---|---|---|---|---|")
    for dim in (2, 3):
        for scheme, make in SCHEMES.items():
            for n in lengths:
                _, spent, work = of_a_step(Case(lambda dim=dim, n=n: chain(dim, n)), make(None), 8, repeat)  # type: ignore[misc]
                print(f"| {dim}D | {scheme} | {n} | {1e3 * spent:.2f} | {work[1]:.1f} | {work[2]:.2f} |", flush=True)


def main() -> None:
    """The table, or the growth with the length of a chain."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--lengths", type=int, nargs="+", default=[10, 100, 400])
    asked = parser.parse_args()
    if asked.growth:
        growth(tuple(asked.lengths), asked.repeat)
    else:
        table(asked.steps, asked.repeat)


if __name__ == "__main__":
    main()
