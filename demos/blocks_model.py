"""Two unit blocks, one on the other, with a manufactured solution: bodies, ties, loads, boundary data, errors.

A solution is a function (x, f) -> (u_x, u_y) of the place and a module f that knows sin, cos and exp: ``numpy`` or ``ufl``.
"""

import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.traces.mortar import mortar
from fmbd_fenicsx.fem.traces.multipliers import default_space
from fmbd_fenicsx.fem.traces.traces import trace_of
from fmbd_fenicsx.linear.presets.krylov import Direct
from fmbd_fenicsx.linear.saddle.elastic import Elastic
from fmbd_fenicsx.linear.saddle.saddle import SaddlePoint
from fmbd_fenicsx.linear.saddle.ties import hold, tie

MU, LAMBDA = fmbd.materials.lame(1.0, 0.3)
BEND = lambda x, f: (f.sin(2 * x[0]) * f.exp(x[1] / 2) / 5, f.cos(x[0] + x[1]) * x[1] / 5)
PATCH = lambda x, f: (0.01 * x[0] + 0.004 * x[1], 0.003 * x[0] - 0.02 * x[1])
OUTER = [(0, "top"), (0, "left"), (0, "right"), (1, "bottom"), (1, "left"), (1, "right")]


def values(solution, x):
    """The solution at places x (n, 2), (n, 2)."""
    return np.stack(np.broadcast_arrays(*solution(x.T, np)), 1)


def interface_traction(solution, x):
    """The exact multiplier at y = 1: minus the stress on the upper block's outward normal (0, -1), by complex steps."""
    steps = (x + 1e-30j * e for e in np.eye(2))
    g = np.stack([values(solution, z).imag / 1e-30 for z in steps], 2)
    s = MU * (g + g.swapaxes(1, 2)) + LAMBDA * np.trace(g, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    return s[:, :, 1]


class Problem:
    """The blocks on two meshes (upper, lower): glue on the interface, all else held weakly to the solution."""

    def __init__(self, degree, meshes, solution):
        law = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, degree)
        self.bodies = [Field(name, mesh, law) for name, mesh in zip(("upper", "lower"), meshes, strict=True)]
        surface = lambda k, name: trace_of(self.bodies[k].space, self.bodies[k].mesh, name)
        space = default_space(degree)
        self.glue = mortar(surface(0, "bottom"), surface(1, "top"), space)
        held = [(k, name, space.on(surface(k, name))) for k, name in OUTER]
        self.ties = [tie("glue", 0, 1, self.glue), *(hold(f"{k}{name}", k, mu) for k, name, mu in held)]
        known = lambda x: values(solution, x)
        self.data = [np.zeros(self.ties[0].rows), *(mu.integrals(known).ravel() for _, _, mu in held)]
        self.exact = [ufl.as_vector(solution(ufl.SpatialCoordinate(b.mesh.dolfinx), ufl)) for b in self.bodies]
        self.loads = [self._load(b, u) for b, u in zip(self.bodies, self.exact, strict=True)]

    def _load(self, body, u):
        """- div sigma(u) against the test functions."""
        e = ufl.sym(ufl.grad(u))
        sigma = 2 * MU * e + LAMBDA * ufl.tr(e) * ufl.Identity(2)
        f = fem.assemble_vector(fem.form(-ufl.inner(ufl.div(sigma), ufl.TestFunction(body.space)) * ufl.dx))
        f.scatter_reverse(la.InsertMode.add)
        return f.array[: 2 * body.n].copy()

    def solve(self):
        """Displacements and multipliers by a direct solver."""
        system = SaddlePoint([Elastic(b) for b in self.bodies], self.ties)
        solver = Direct().solver(system)
        found = solver.solve(self.loads, self.data)
        solver.destroy(), system.destroy()
        return found

    def errors(self, found):
        """Errors of u in L2 and in the seminorm of H1."""
        squares = np.zeros(2)
        for b, u, mine in zip(self.bodies, self.exact, found.u, strict=True):
            uh = fem.Function(b.space)
            uh.x.array[: 2 * b.n] = mine
            uh.x.scatter_forward()
            for i, e in enumerate((uh - u, ufl.grad(uh - u))):
                own = fem.assemble_scalar(fem.form(ufl.inner(e, e) * ufl.dx(degree=8)))
                squares[i] += b.comm.allreduce(own, op=MPI.SUM)
        return np.sqrt(squares)

    def destroy(self):
        [b.destroy() for b in self.bodies]
