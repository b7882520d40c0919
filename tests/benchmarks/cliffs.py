"""CPU time of a step of many small scenes in every scheme, sorted: what stands out beside its neighbours fell off the fast path.

Run:  ./with-dolfinx python3 tests/benchmarks/cliffs.py [--scheme WORD] [--body WORD] [--element WORD] [--every 1] [--json FILE]

A step is the difference of whole runs of N and 2 N steps; ``compiled`` is the share of steps that the driver made.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from combinations import BODIES, FEATURES, SCHEMES, floor, pinned  # noqa: E402

import fmbd_fenicsx as fmbd  # noqa: E402
from fmbd_fenicsx.errors import FmbdError, InputError  # noqa: E402

SHORTEST = 0.03  # s of CPU time that the longer run should take
MOST = 2000  # steps
TIMES, ANGLES = (0.0, 0.02, 0.05, 1.0), (0.0, 0.1, 0.1, 0.0)  # s, rad: of a table


# ---- elements, beside those of tests/combinations.py ----------------------------------------------------------
def on_hinge(add):
    """A feature that acts on the angle of the hinge."""

    def feature(scene, rod):
        scene.add(add(fmbd.angle(pinned(scene, rod))))

    return feature


def on_tip(add):
    """A feature that acts on the tip of a rod that hangs in a hinge."""

    def feature(scene, rod):
        pinned(scene, rod)
        scene.add(add(rod))

    return feature


def second_body(connect):
    """A rigid bob at the tip, connected."""

    def feature(scene, rod):
        pin = pinned(scene, rod)
        inertia = 1.0 if rod.body.dim == 2 else (1.0, 1.0, 1.0)
        bob = fmbd.RigidBody("bob", 20.0, inertia, rod.at(1.2, 0.0))
        scene.add(bob, *connect(scene, rod, bob, pin))

    return feature


def geared(scene, rod, bob, pin):
    hinge = fmbd.revolute("second", rod.tip, bob, center=rod.at(1, 0))
    return hinge, fmbd.gear("gear", fmbd.angle(pin), fmbd.angle(hinge), ratio=2.0)


def tyred(rod):
    road = lambda x, t: -1.0 + 0.01 * np.sin(x[0])  # noqa: E731
    up = (0.0, 1.0, 0.0)
    return fmbd.Tyre("tyre", rod.tip, None, rod.at(1, 0), None, road, 0.999, 1e4, 10.0, up)


def stop(scene, rod):
    scene.add(fmbd.joint_limit("stop", fmbd.angle(pinned(scene, rod)), lower=-0.05, upper=0.05))


def twice(scene, rod):
    pinned(scene, rod)
    scene.add(fmbd.revolute("again", fmbd.ground, rod.left, center=rod.at(0, 0)))


def plain(kind):
    return second_body(lambda scene, rod, bob, pin: (kind(rod, bob),))


MORE = {
    "joint spring": on_hinge(lambda a: fmbd.joint_spring("spring", a, stiffness=100.0, damping=1.0)),
    "motor": on_hinge(lambda a: fmbd.forces.motor("motor", a, target=lambda t: t, kp=100.0, kd=5.0)),
    "motor by a table": on_hinge(
        lambda a: fmbd.forces.motor("motor", a, target=lambda t: np.interp(t, TIMES, ANGLES), kp=100.0, kd=5.0)
    ),
    "drive with kinks": on_hinge(lambda a: fmbd.drive("drive", a, lambda t: 0.1 * abs(math.sin(20.0 * t)))),
    "pid": on_hinge(lambda a: fmbd.forces.pid("pid", a, target=lambda t: t, gains=(100.0, 10.0, 5.0))),
    "dry friction": on_hinge(lambda a: fmbd.dry_friction("dry", a, limit=5.0, stick=1e4, damping=10.0)),
    "smooth friction": on_hinge(lambda a: fmbd.joint_friction("smooth", a, coulomb=5.0, speed=0.01)),
    "elastic stop": on_hinge(lambda a: fmbd.elastic_stop("stop", a, upper=0.05, lower=-0.05, stiffness=1e5)),
    "joint limit": stop,
    "effort": on_hinge(lambda a: fmbd.effort("effort", a, lambda t: np.sin(t))),
    "own force": on_tip(lambda rod: fmbd.own_force("own", rod.tip, None, lambda t, a: (-5.0 * a.v, 0.0 * a.w))),
    "tyre": on_tip(tyred),
    "hinge twice": twice,
    "two bodies": plain(lambda rod, bob: fmbd.revolute("second", rod.tip, bob, center=rod.at(1, 0))),
    "welded": plain(lambda rod, bob: fmbd.fixed("second", rod.tip, bob, center=rod.at(1, 0))),
    "slider": plain(lambda rod, bob: fmbd.prismatic("second", rod.tip, bob, axis=rod.at(1, 0), center=rod.at(1, 0))),
    "bushing between": plain(
        lambda rod, bob: fmbd.bushing(
            "second", rod.tip, bob, stiffness=np.full(3 if bob.dim == 2 else 6, 1e4), center=rod.at(1, 0)
        )
    ),
    "gear": second_body(geared),
}
ELEMENTS = {**FEATURES, **MORE}
SLOW = ("incompressible", "pressure", "large strain", "large strain, floating")


def rigid_in_space():
    """A rigid rod in space."""
    from combinations import Hung

    body = fmbd.RigidBody("rod", 100.0, (1.0, 9.0, 9.0), position=(0.5, 0.0, 0.0))
    return Hung(body, body, body)


KINDS = {"rigid": BODIES["rigid"], "rigid, space": rigid_in_space} | BODIES


def scene_of(body, element, scheme):
    """The rod that falls, with the sensor of its tip and four more."""
    rod = KINDS[body]()
    scene = fmbd.Scene(f"{body}, {element}", gravity=rod.at(0, -9.81))
    scene.add(rod.body)
    ELEMENTS[element](scene, rod)
    if scheme.startswith(("Moreau", "contact")) and not scene.unilateral:
        floor(scene, rod, below=50.0)
    at = {"point": rod.at(1.0, 0.0)} if isinstance(rod.body, fmbd.RigidBody) else {}
    for name, sensor in (("tip", fmbd.position), ("speed", fmbd.velocity), ("turn", fmbd.rotation)):
        scene.sensor(name, sensor(rod.tip, **(at if name != "turn" else {})))
    for joint in list(scene.joints)[:1]:
        scene.sensor("force", fmbd.reaction_force(joint))
    return scene


def cost(body, element, scheme, every):
    """Microseconds of CPU time a step, share of compiled steps."""
    step = 2e-5 if scheme in ("RATTLE", "half-explicit") and body not in ("rigid", "rigid, space") else 1e-3

    def spent(steps):
        scene = scene_of(body, element, scheme)
        output = fmbd.Output(every=every or 10**9, progress=False)
        begin = time.process_time()
        run = fmbd.solve(scene, t_end=steps * step, dt=step, scheme=SCHEMES[scheme](), output=output)
        return time.process_time() - begin, run.counters.get("compiled_steps", 0.0) / steps

    steps = 20
    while True:
        one, (two, share) = spent(steps)[0], spent(2 * steps)
        if two - one > SHORTEST / 2 or 2 * steps >= MOST:
            return (two - one) / steps * 1e6, share
        steps = min(MOST // 2, int(steps * min(max(SHORTEST / max(two - one, 1e-3), 2.0), 20.0)))


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scheme", default="")
    parser.add_argument("--body", default="")
    parser.add_argument("--element", default="")
    parser.add_argument("--every", type=int, default=0, help="records every so many steps; 0: none")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()

    rows = []
    for scheme in (s for s in SCHEMES if given.scheme in s and "FieldSplit" not in s and "chosen" not in s):
        for body in (b for b in KINDS if given.body in b and b not in SLOW):
            for element in (e for e in ELEMENTS if given.element in e):
                try:
                    rows.append((*cost(body, element, scheme, given.every), scheme, body, element))
                except (InputError, NotImplementedError):
                    continue
                except (FmbdError, TypeError, ValueError) as error:
                    print(f"{scheme} / {body} / {element}: {str(error)[:90]}", flush=True)
    rows.sort(reverse=True)
    for us, share, *names in rows:
        print(f"{us:10.1f} us a step, {share:4.0%} compiled: {' / '.join(names)}")
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
