"""Andrews' squeezing mechanism: seven planar bodies, a stiff spring, a driving torque; kinematic loops that close six times.

Run:  ./with-dolfinx python3 demos/andrews.py          (--fast: looser tolerance; --picture FILE, --animate FILE)

Seven angles q, six loop equations g(q) = 0; data, equations and reference: ``andrews_model.py``.
"""

import numpy as np
from andrews_model import REFERENCE, scene

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo


def main():
    """Solve, compare, report."""
    args = demo.arguments(__doc__)
    scheme = fmbd.Radau(stages=3, form=fmbd.GGL(), rtol=1e-6 if args.fast else 1e-8)
    run = fmbd.solve(scene(), t_end=0.03, scheme=scheme, output=demo.snapshots(args))
    names = ("beta", "gamma", "delta")
    known = {f"angles {name}": (0.03, REFERENCE[k]) for name, k in zip(names, (0, 2, 4), strict=True)}
    demo.show(run, args, [f"angles {name}" for name in names], reference=known, view=fmbd.View(instants=3))
    error = float(np.max(np.abs(run["angles"][-1] / REFERENCE - 1)))
    demo.finish(
        [demo.Check("largest relative error of the angles", error, 0.0, 1e-7 if args.fast else 1e-9)], run, args
    )


if __name__ == "__main__":
    main()
