r"""Rolling without slip: the benchmark bicycle, its weave and capsize speeds, and rides just beside them.

Run:  ./with-dolfinx python3 demos/bicycle.py --picture bicycle.png

            frame and rider, 85 kg        no hands: four rigid bodies, three hinges, two knife-edge wheels that roll
              \_______/                   on a plane; the steering axis is tilted by 18 degrees
              /  \   / \
            (o)   \_/  (O)                modes about riding straight on: weave oscillates and grows below 4.29 m/s,
          ---+---------+----              capsize grows slowly above 6.02 m/s, between them it rides by itself

Data and reference speeds: Meijaard, Papadopoulos, Ruina and Schwab, doi:10.1098/rspa.2007.1857.
"""

import numpy as np
from bicycle_model import CAPSIZE, WEAVE, build, lateral, missed, picture
from scipy.optimize import brentq

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check


def ride(speed, args):
    """The run after a small push."""
    return fmbd.solve(build(speed, 1e-4), t_end=4.0 if args.fast else 8.0, dt=2e-3, output=demo.snapshots(args))


def seen(run):
    """Times, steering angle (rad) and energy (J) of a run."""
    return run.times, run["steer"][:, 0], run.energy["kinetic"] + run.energy["weight"]


def main():
    """Critical speeds to 1e-8, and rides that weave, recover and fall as the eigenvalues say."""
    args = demo.arguments(__doc__)
    weave = brentq(lambda v: lateral(v)[0].real, 4.0, 5.0, xtol=1e-10)
    capsize = brentq(lambda v: lateral(v)[1], 5.5, 6.5, xtol=1e-10)
    runs = {v: ride(v, args) for v in (4.0, 5.0, 8.0)}
    rides = {v: seen(run) for v, run in runs.items()}
    late = {v: np.abs(y[-1] / y[np.searchsorted(t, 2.0)]) for v, (t, y, _) in rides.items()}
    checks = [
        Check("weave speed (m/s)", weave, WEAVE, 1e-8),
        Check("capsize speed (m/s)", capsize, CAPSIZE, 1e-8),
        *(
            Check(f"ride at {v:g} m/s, not of its modes (share)", missed(v, t, y), 0.0, 2e-3)
            for v, (t, y, _) in rides.items()
        ),
        Check.at_least("weave grows at 4 m/s", late[4.0], 1.2),
        Check.at_least("all decays at 5 m/s", 1.0 / late[5.0], 1.2),
        Check.at_least("capsize grows at 8 m/s", late[8.0], 1.2),
        Check("energy kept (share)", max(np.ptp(e) / e[0] for _, _, e in rides.values()), 0.0, 1e-9),
    ]
    if args.picture:
        picture(args, rides)
    demo.film(runs[5.0], args, ["steer"], view=fmbd.View(camera=(0.2, -1.0, 0.3), symbols=False))
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
