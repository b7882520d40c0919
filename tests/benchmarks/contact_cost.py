"""Scenes of rigid contact: CPU time of a step by the difference of two runs, and the share of steps that compiled code made.

Run:  ./with-dolfinx python3 tests/benchmarks/contact_cost.py [--repeat 3] [--scene WORD]
"""

import argparse
import time

import numpy as np

import fmbd_fenicsx as fmbd

G = 9.81


def on_floor(body, points, **law):
    """A scene of one body over the plane z = 0 (y = 0)."""
    up = np.eye(body.dim)[-1]
    scene = fmbd.Scene("contact", gravity=tuple(-G * up))
    scene.add(body, fmbd.contact("floor", points, fmbd.Obstacle("floor", fmbd.HalfSpace(0 * up, up)), **law))
    return scene


def ball():
    """A sphere thrown onto the plane."""
    sphere = fmbd.RigidBody("ball", 1.0, (0.004,) * 3, (0, 0, 0.5), velocity=(1.0, 0, 0))
    return on_floor(sphere, fmbd.ball(sphere, 0.1), restitution=0.7, friction=0.3)


def cylinder():
    """A cylinder of the plane that slides, then rolls."""
    disk = fmbd.RigidBody("disk", 1.0, 0.005, (0, 0.1), velocity=(1.0, 0))
    return on_floor(disk, fmbd.ball(disk, 0.1), friction=0.3)


def plate():
    """A plate that rattles on its four corners."""
    body = fmbd.RigidBody(
        "plate", 1.0, (0.0842, 0.0842, 0.1667), (0, 0, 0.2), velocity=(0.5, 0.2, 0), angular_velocity=(0.3, 0.7, 1.0)
    )
    corners = [(x, y, -0.05) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    return on_floor(body, fmbd.corners(body, corners), friction=0.3, restitution=0.4)


def cam():
    """A follower on a guide over an eccentric disk that turns as prescribed."""
    e, r, w = 0.02, 0.05, 6 * np.pi
    follower = fmbd.RigidBody("follower", 0.5, 0.01, (0, r - e + 0.01))
    turning = lambda t: ((e * np.sin(w * t), -e * np.cos(w * t)), w * t)  # noqa: E731
    scene = fmbd.Scene("cam", gravity=(0, -G))
    disk = fmbd.Obstacle("cam", fmbd.Sphere(r), motion=turning)
    scene.add(follower, fmbd.contact("cam", fmbd.ball(follower, 0.01), disk))
    scene.add(fmbd.prismatic("guide", fmbd.ground, follower, axis=(0, 1)))
    return scene


def belt():
    """A block that a belt carries along."""
    block = fmbd.RigidBody("block", 1.0, 1 / 600, (0, 0.05))
    moving = fmbd.Obstacle("belt", fmbd.HalfSpace((0, 0), (0, 1)), motion=lambda t: ((2.0 * t, 0.0), 0.0))
    scene = fmbd.Scene("belt", gravity=(0, -G))
    feet = fmbd.corners(block, [(x, -0.05) for x in (-0.05, 0.05)])
    scene.add(block, fmbd.contact("belt", feet, moving, friction=0.4))
    return scene


def board():
    """A board at rest on 280 points."""
    body = fmbd.RigidBody("board", 1.0, 0.1, (0, 0.05))
    return on_floor(body, fmbd.corners(body, [(x, -0.05) for x in np.linspace(-0.5, 0.5, 280)]), friction=0.3)


def hopper():
    """Twelve balls that fall into a hopper, where they lie on each other with friction."""
    r, n, half = 0.05, 12, 0.15
    places = [(0.13 * (i % 2) - 0.06, 0.13 * (i // 2 % 2) - 0.07, 0.3 + 0.13 * (i // 4)) for i in range(n)]
    balls = [fmbd.RigidBody(f"ball {i}", 1.0, (0.4 * r * r,) * 3, place) for i, place in enumerate(places)]
    walls = [fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), (0, 0, 1)))]
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        steep = np.array((-x, -y, 0.8)) / np.hypot(1.0, 0.8)
        walls.append(fmbd.Obstacle(f"wall {x} {y}", fmbd.HalfSpace((half * x, half * y, 0.8 * half), tuple(steep))))

    scene = fmbd.Scene("hopper", gravity=(0, 0, -G))
    scene.add(*balls)
    law = {"friction": 0.3, "restitution": 0.2}
    for i, one in enumerate(balls):
        for other in walls:
            scene.add(fmbd.contact(f"{i} on {other.name}", fmbd.ball(one, r), other, **law))
        for j in range(i):
            other = fmbd.Obstacle(f"{j} for {i}", fmbd.Sphere(r), on=balls[j])
            scene.add(fmbd.contact(f"{i} on {j}", fmbd.ball(one, r), other, **law))
    return scene


SCENES = {
    "ball": (ball, 1e-3),
    "rolling cylinder": (cylinder, 1e-3),
    "plate": (plate, 4e-3),
    "cam": (cam, 1e-3),
    "belt": (belt, 1e-3),
    "board": (board, 1e-3),
    "hopper": (hopper, 1e-3),
}


def seconds(make, h, steps):
    """CPU time of a run, and its counters."""
    scene = make()
    begin = time.process_time()
    output = fmbd.Output(every=100, progress=False)
    run = fmbd.solve(scene, t_end=steps * h, dt=h, scheme=fmbd.Moreau(), output=output)
    return time.process_time() - begin, run.counters


def main():
    """One line a scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--scene", default="")
    given = parser.parse_args()
    for name, (make, h) in ((name, x) for name, x in SCENES.items() if given.scene in name):
        seconds(make, h, 20)
        rows = []
        for _ in range(given.repeat):
            (a, _), (b, counters) = seconds(make, h, 400), seconds(make, h, 800)
            rows.append((b - a) / 400 * 1e6)
        compiled = counters.get("compiled_steps", 0.0) / 800
        print(f"{name}: {np.median(rows):.0f} us a step, {100 * compiled:.0f} % of them compiled")


if __name__ == "__main__":
    main()
