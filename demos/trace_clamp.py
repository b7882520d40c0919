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
from fmbd_fenicsx import demo, plot, study
from fmbd_fenicsx.fem.traces.multipliers import Aggregated, Continuous, Discontinuous, Dual, Ends
from fmbd_fenicsx.fem.traces.stability import infsup
from fmbd_fenicsx.post.demo import Check

KEPT, P1 = Continuous(ends=Ends.KEPT), Continuous(1, Ends.KEPT)
# degree of V_h, multiplier space, constants at n = 8 with free and with clamped neighbours
SPACES = [(1, KEPT, 0.612, 0.0), (1, Continuous(), 0.634, 0.603), (1, Continuous(ends=Ends.DROPPED), 0.630, 0.621),
          (1, Dual(), 0.629, 0.622), (1, Discontinuous(0), 0.222, 0.0), (1, Aggregated(), 0.800, 0.731),
          (2, KEPT, 0.583, 0.0), (2, P1, 0.892, 0.709), (2, Discontinuous(0), 0.864, 0.848),
          (2, Discontinuous(1), 0.173, 0.0)]  # fmt: skip
SIDES = ("left", "right")


def square(n):
    return fmbd.read_gmsh("meshes/block.py", cells=n)


def clamped_plate(n):
    """Multiplier space on the clamp, its values; load 0.1 N/m downwards on the right face."""
    elastic, shear = fmbd.materials.linear_elastic(1.0, 0.3), fmbd.loads.traction("right", (0.0, -0.1))
    plate = fmbd.AbsoluteBody("plate", square(n), degree=2, density=1.0, elastic=elastic, loads=[shear])
    scene = fmbd.Scene("clamped plate")
    scene.add(plate, fmbd.tie_surface("clamp", plate.surface("left"), fmbd.ground, space=P1))
    found = fmbd.equilibrium(scene)
    ((clamp, rows),) = found.system.traces
    return clamp.multipliers, found.state.lam[rows].reshape(-1, 2)  # force on the plate


args = demo.arguments(__doc__)
sizes = (4, 8) if args.fast else (4, 8, 16, 32)
meshes = {n: square(n) for n in {*sizes, *(min(4 * n, 64) for n in sizes)}}
rows, checks = [["V / multipliers", *(f"{where}, n = {n}" for where in ("free", "clamped") for n in sizes)]], []
for degree, space, *wanted in SPACES:
    line = []
    for clamped, where, value in zip(((), SIDES), ("free", "clamped"), wanted, strict=True):
        fine = lambda n: (meshes[min(4 * n, 64)], 2)
        found = [infsup((meshes[n], "bottom"), space, degree=degree, clamped=clamped, reference=fine(n)) for n in sizes]
        line += [f"{r.constant:.3f} ({r.zero_modes})" for r in found]
        checks.append(Check(f"{found[1].name}, {where}", found[1].constant, value, 2e-3))
    rows.append([found[0].name, *line])
demo.say(study.aligned(rows))
mu, lam = clamped_plate(16)
force = (np.asarray(mu.coupling().sum(axis=1)).T @ lam)[0]
checks += [Check("clamp force, x", force[0], 0.0, 1e-12), Check("clamp force, y", force[1], 0.1, 1e-12)]
if args.picture:
    y, traction = mu.trace.corners[:, :, 1], mu.coefficients(lam)
    with plot.figure(args.picture, title=args.title) as axes:
        for k, name in enumerate(("normal", "shear")):
            axes.plot(y.T, traction[:, :, k].T, f"C{k}.-", label=name)
        axes.axhline(0.1, **plot.REFERENCE, label="mean shear, by equilibrium")
        axes.set(xlabel="y (m); the corners are singular points", ylabel="traction on the clamp (Pa)")
demo.finish(checks, None, args)
