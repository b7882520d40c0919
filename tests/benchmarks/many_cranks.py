"""A thousand slider cranks of different data, a thousand steps each, by ``study.map``: seconds on all cores.

Run:  ./with-dolfinx python3 tests/benchmarks/many_cranks.py [--count 1000] [--steps 1000]
"""

import argparse
import os
import time

import numpy as np

import fmbd_fenicsx as fmbd

H = 1e-3


def crank(length):
    """A crank of 0.15 m and a rod of the given length that moves a block; coasting from 15 rad/s."""
    r, w = 0.15, 15.0
    scene = fmbd.Scene("crank")
    one = fmbd.RigidBody("crank", 0.36, 0.001, (r / 2, 0), 0.0, (0, w * r / 2), w)
    omega = -w * r / length
    two = fmbd.RigidBody("rod", 0.15, 0.0012, (r + length / 2, 0), 0.0, (0, w * r / 2), omega)
    three = fmbd.RigidBody("block", 0.0756, 1e-4, (r + length, 0))
    scene.add(one, two, three, fmbd.revolute("main", fmbd.ground, one, center=(0, 0)))
    scene.add(fmbd.revolute("knee", one, two, center=(r, 0)))
    scene.add(fmbd.revolute("wrist", two, three, center=(r + length, 0)))
    scene.add(fmbd.prismatic("slider", fmbd.ground, three, axis=(1, 0), center=(0, 0)))
    scene.sensor("block", fmbd.position(three))
    return scene


def main():
    """Seconds of all, and of one alone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=1000)
    given = parser.parse_args()
    lengths = np.linspace(0.25, 0.5, given.count).tolist()
    output = fmbd.Output(every=100, progress=False)
    settings = {"t_end": given.steps * H, "dt": H, "output": output}

    alone = fmbd.solve(crank(lengths[-1]), **settings)
    begin, used = time.perf_counter(), os.times()
    found = fmbd.study.map(crank, lengths, **settings)
    seconds, spent = time.perf_counter() - begin, os.times()
    cpu = sum(spent[:4]) - sum(used[:4])
    same = np.array_equal(found[-1]["block"], alone["block"]) and np.array_equal(found[-1].end[0], alone.state.q)
    print(
        f"{given.count} cranks, {given.steps} steps each: {seconds:.2f} s, {cpu:.2f} s of CPU time; last one as alone: {same}"
    )


if __name__ == "__main__":
    main()
