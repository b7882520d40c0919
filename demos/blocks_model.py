"""Two unit blocks, one on the other, with a manufactured solution: bodies, ties, loads, boundary data, errors.

A solution is a function (x, f) -> (u_x, u_y) of the place and a module f that knows sin, cos and exp: ``numpy`` or ``ufl``.
"""

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.traces.multipliers import default_space

MU, LAMBDA = fmbd.materials.lame(1.0, 0.3)
BEND = lambda x, f: (f.sin(2 * x[0]) * f.exp(x[1] / 2) / 5, f.cos(x[0] + x[1]) * x[1] / 5)
PATCH = lambda x, f: (0.01 * x[0] + 0.004 * x[1], 0.003 * x[0] - 0.02 * x[1])
OUTER = [(0, "top"), (0, "left"), (0, "right"), (1, "bottom"), (1, "left"), (1, "right")]


def values(solution, x):
    """The solution at places x (2, n), (2, n)."""
    return np.stack(np.broadcast_arrays(*solution(x, np)))


def interface_traction(solution, x):
    """The exact multiplier at y = 1: the stress on the upper block's outward normal (0, -1), by complex steps; x (n, 2)."""
    steps = (x + 1e-30j * e for e in np.eye(2))
    g = np.stack([values(solution, z.T).T.imag / 1e-30 for z in steps], 2)
    s = MU * (g + g.swapaxes(1, 2)) + LAMBDA * np.trace(g, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    return -s[:, :, 1]


def exact(solution, mesh):
    """The solution in UFL."""
    return ufl.as_vector(solution(ufl.SpatialCoordinate(mesh), ufl))


def pushed(solution):
    """The load - div sigma(u)."""

    def form(v, dx, ds):
        e = ufl.sym(ufl.grad(exact(solution, dx.ufl_domain())))
        return -ufl.inner(ufl.div(2 * MU * e + LAMBDA * ufl.tr(e) * ufl.Identity(2)), v) * dx

    return fmbd.loads.Load(form)


def solve(degree, meshes, solution):
    """The equilibrium on two meshes (upper, lower): glue on the interface, all else held weakly to the solution."""
    scene, space = fmbd.Scene("blocks"), default_space(degree)
    given = {"degree": degree, "density": 1.0, "elastic": fmbd.materials.linear_elastic(1.0, 0.3)}
    pairs = zip(("upper", "lower"), meshes, strict=True)
    bodies = [fmbd.AbsoluteBody(name, mesh, **given, loads=[pushed(solution)]) for name, mesh in pairs]
    scene.add(*bodies, fmbd.tie_surface("glue", bodies[0].surface("bottom"), bodies[1].surface("top"), space=space))
    known = {"space": space, "shape": lambda x: values(solution, x)}
    scene.add(*(fmbd.tie_surface(f"{k}{side}", bodies[k].surface(side), fmbd.ground, **known) for k, side in OUTER))
    return fmbd.equilibrium(scene)


def errors(found, solution):
    """Errors of u in L2 and in the seminorm of H1."""
    squares = np.zeros(2)
    for k, part in found.system.fields:
        uh, mine = fem.Function(part.field.space), found.system.local_q(found.state.q, k)
        uh.x.array[: len(mine)] = mine
        uh.x.scatter_forward()
        off = uh - exact(solution, part.field.mesh.dolfinx)
        for i, e in enumerate((off, ufl.grad(off))):
            own = fem.assemble_scalar(fem.form(ufl.inner(e, e) * ufl.dx(degree=8)))
            squares[i] += part.comm.allreduce(own, op=MPI.SUM)
    return np.sqrt(squares)


def glue(found):
    """Multiplier space of the interface and its values, the traction on the upper block."""
    tie, rows = found.system.traces[0]
    return tie.multipliers, found.state.lam[rows].reshape(-1, 2)
