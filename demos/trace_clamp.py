"""A plate clamped by field multipliers on one face, and the inf-sup constants of the multiplier spaces that one could choose.

Run:  ./with-dolfinx python3 demos/trace_clamp.py          (--fast: n = 4, 8; --picture FILE: clamp traction; mpirun -n 2 works)

    |=========+
    |  plate  |  --> shear traction          int_clamp mu . u dS = 0 for all mu; the multiplier is the clamp's traction.
    |=========+                              Its sum balances the load to roundoff. P1 beside P2 displacements.

The table is the smallest generalised singular value of the coupling in the H1 norm and the dual of the trace norm of a finer P2
space (Chapelle and Bathe, doi:10.1016/0045-7949(93)90340-J): it must not fall with h. (k) counts zero modes.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.linear.presets import Direct
from fmbd_fenicsx.linear.saddle import Elastic, SaddlePoint, hold
from fmbd_fenicsx.traces.fields import ElasticForms, Field
from fmbd_fenicsx.traces.multipliers import Aggregated, Continuous, Discontinuous, Dual, Ends
from fmbd_fenicsx.traces.stability import infsup
from fmbd_fenicsx.traces.traces import trace_of

KEPT, P1 = Continuous(ends=Ends.KEPT), Continuous(1, Ends.KEPT)
# degree of V_h, multiplier space, constants at n = 8 with free and with clamped neighbours
SPACES = [(1, KEPT, 0.612, 0.0), (1, Continuous(), 0.634, 0.603), (1, Continuous(ends=Ends.DROPPED), 0.630, 0.621),
          (1, Dual(), 0.629, 0.622), (1, Discontinuous(0), 0.222, 0.0), (1, Aggregated(), 0.800, 0.731),
          (2, KEPT, 0.583, 0.0), (2, P1, 0.892, 0.709), (2, Discontinuous(0), 0.864, 0.848),
          (2, Discontinuous(1), 0.173, 0.0)]  # fmt: skip
SIDES = ("left", "right")


def square(n):
    return fmbd.read_gmsh("meshes/block.py", cells=n)


def table(sizes):
    """Lines of the table, and a check of each constant at n = 8."""
    meshes = {n: square(n) for n in {*sizes, *(min(4 * n, 64) for n in sizes)}}
    checks = []
    demo.say("V / multipliers                     neighbours free" + " " * 10 * (len(sizes) - 1) + "neighbours clamped")
    for degree, space, free, clamped in SPACES:
        found = {c: [infsup((meshes[n], "bottom"), space, degree=degree, clamped=c, reference=(meshes[min(4 * n, 64)], 2))
                     for n in sizes]
                 for c in ((), SIDES)}  # fmt: skip
        line = "   ".join(" ".join(f"{r.constant:.3f} ({r.zero_modes})" for r in found[c]) for c in found)
        demo.say(f"{found[()][0].name:<34}  {line}")
        for c, wanted in (((), free), (SIDES, clamped)):
            where = "clamped" if c else "free"
            checks.append(demo.Check(f"{found[c][1].name}, {where}", found[c][1].constant, wanted, 2e-3))
    return checks


def clamped_plate(n):
    """Trace of the clamp, multiplier values, total clamp force; load 0.1 N/m downwards on the right face."""
    plate = Field("plate", square(n), ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, 2))
    mu, face = P1.on(trace_of(plate.space, plate.mesh, "left")), trace_of(plate.space, plate.mesh, "right")
    load, mine = np.zeros((plate.n, 2)), face.owned >= 0
    load[face.owned[mine], 1] = -0.1 * (face.mass() @ np.ones(face.n))[mine]
    system = SaddlePoint([Elastic(plate)], [hold("clamp", 0, mu)])
    solver = Direct().solver(system)
    lam = -solver.solve([load.ravel()], [np.zeros(2 * mu.n)]).multipliers[0].reshape(-1, 2)  # force on the plate
    force = np.asarray(mu.coupling().sum(axis=1)).T @ lam
    solver.destroy(), system.destroy(), plate.destroy()
    return mu, lam, force[0]


if __name__ == "__main__":
    args = demo.arguments(__doc__)
    checks = table((4, 8) if args.fast else (4, 8, 16, 32))
    mu, lam, force = clamped_plate(16)
    checks += [
        demo.Check("clamp force, x", force[0], 0.0, 1e-12),
        demo.Check("clamp force, y", force[1], 0.1, 1e-12),
    ]
    if args.picture is not None and mu.trace.comm.rank == 0:
        import matplotlib.pyplot as plt

        values = mu.coefficients(lam)
        for k, name in enumerate(("normal", "shear")):
            y = mu.trace.corners[:, :, 1]
            for f in range(len(y)):
                plt.plot(y[f], values[f, :, k], f"C{k}-", label=name if f == 0 else None)
        plt.title("P1 multipliers beside P2, 16 cells; the plate's corners are singular points", fontsize=10)
        plt.xlabel("y, m"), plt.ylabel("traction on the clamp, Pa"), plt.legend(), plt.grid(alpha=0.3)
        plt.savefig(args.picture, dpi=110)
    demo.finish(checks, None, args)
