"""A cantilever hit at its end, cut into subdomains with meshes that do not match: waves travel through the interfaces.

Run:  ./with-dolfinx python3 demos/domain_decomposition.py --parts 4     (mpirun -n 2 ...; --fast; --picture FILE: the waves)

    clamp |== 0 ==|== 1 ==|== 2 ==|== 3 ==| <- smooth axial pulse       pieces by Cholesky, each on one rank

Interfaces and clamp are held by P1 multipliers beside P2 displacements, solved through the dual problem S lam = d by conjugate
gradients with the fractional preconditioner. Trapezoidal steps. Reference: d'Alembert's solution for the tip's velocity and the
traction at every interface; the pulse p comes back from the clamp as it is and from the free end turned over,

    sigma(x, t) = p(t - (L - x)) + p(t - (L + x)) - p(t - (3 L - x)) - p(t - (3 L + x)) + ...
"""

import numpy as np
from domain_model import LENGTH, WORLD, errors, march, picture, pieces
from dual_interface import DualInterface, shared_traces

from fmbd_fenicsx import demo
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Ends
from fmbd_fenicsx.fem.traces.traces import trace_of
from fmbd_fenicsx.post.demo import Check

SPACE = Continuous(1, Ends.KEPT)


def wave(parts, cells):
    """The run in so many pieces and cells; a step is half the time that the wave takes through a cell."""
    dt = LENGTH / cells / 2
    own = pieces(parts, cells, dt)
    sides = {(i, s): trace_of(e.body.space, e.body.mesh, s) for i, e in own.items() for s in ("left", "right")}
    traces = shared_traces(WORLD, sides)
    dual = DualInterface(WORLD, own, traces)
    dual.hold((0, "left"), SPACE)

    # the finer side of an interface carries the multipliers
    for i in range(1, parts):
        a, b = (i, "left"), (i - 1, "right")
        dual.tie(*((a, b) if traces[a].h < traces[b].h else (b, a)), SPACE)
    dual.prepare()
    return march(dual, parts, dt)


args = demo.arguments(__doc__, {"--parts": 4})
cells = (24, 48) if args.fast else (16, 32, 64, 128)
whole = errors(1, *wave(1, cells[-1]))
runs = [wave(args.parts, n) for n in cells]
cut = [errors(args.parts, *found) for found in runs]
first, second = (np.log2(cut[-2][k] / cut[-1][k]) for k in (0, 1))
checks = [
    Check.at_least("order of the tip velocity in h = 2 c dt", first, 1.8),
    Check.at_least("order of the tractions", second, 1.8),
    Check.relative("error with interfaces against one piece", cut[-1][0], whole[0], 0.1),
    Check("iterations beyond 25", max(max(found[-1] for found in runs) - 25, 0.0), 0.0),
]
if args.picture:
    picture(args, cells, runs)
demo.finish(checks, None, args)
