"""Two blocks with meshes that do not match, glued by field multipliers on the true intersections of their facets.

Run:  ./with-dolfinx python3 demos/mortar_blocks.py          (--fast: three meshes; --picture FILE: errors against h)

      +---------+
      |  upper  |   7 n cells a side      Patch test: constant stress passes to roundoff.
      +---------+   glue, multipliers     Smooth solution: orders 2 / 1 (P1) and 3 / 2 (P2) of u in L2 / H1, and the order of
      |  lower  |   5 n cells a side      the interface traction in H^-1/2 and in the h-weighted L2 norm.
      +---------+   the rest of the boundary is held weakly; cross-points by merged ends
"""

import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.linear.presets import Direct
from fmbd_fenicsx.linear.saddle import Elastic, SaddlePoint, data, hold, tie
from fmbd_fenicsx.traces.fields import ElasticForms, Field
from fmbd_fenicsx.traces.mortar import mortar
from fmbd_fenicsx.traces.multipliers import default_space
from fmbd_fenicsx.traces.stability import DualNorm
from fmbd_fenicsx.traces.traces import trace_of

MU, LAMBDA = fmbd.materials.lame(1.0, 0.3)
BEND = lambda x, f: (f.sin(2 * x[0]) * f.exp(x[1] / 2) / 5, f.cos(x[0] + x[1]) * x[1] / 5)
PATCH = lambda x, f: (0.01 * x[0] + 0.004 * x[1], 0.003 * x[0] - 0.02 * x[1])


class Numpy:
    sin, cos, exp = np.sin, np.cos, np.exp


def stress(u):
    e = ufl.sym(ufl.grad(u))
    return 2 * MU * e + LAMBDA * ufl.tr(e) * ufl.Identity(2)


class Problem:
    """The blocks on two meshes (upper, lower), loads and boundary data of a solution."""

    def __init__(self, degree, meshes, solution):
        law = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, degree)
        self.bodies = [Field(name, mesh, law) for name, mesh in zip(("upper", "lower"), meshes, strict=True)]
        surface = lambda k, name: trace_of(self.bodies[k].space, self.bodies[k].mesh, name)
        space, values = default_space(degree), lambda x: np.stack(np.broadcast_arrays(*solution(x.T, Numpy)), 1)
        self.glue = mortar(surface(0, "bottom"), surface(1, "top"), space)
        outer = [(0, "top"), (0, "left"), (0, "right"), (1, "bottom"), (1, "left"), (1, "right")]
        held = [(k, name, space.on(surface(k, name))) for k, name in outer]
        self.ties = [tie("glue", 0, 1, self.glue), *(hold(f"{k}{name}", k, mu) for k, name, mu in held)]
        self.data = [np.zeros(self.ties[0].rows), *(data(mu, values) for _, _, mu in held)]
        self.loads, self.exact = [], []
        for b in self.bodies:
            u = ufl.as_vector(solution(ufl.SpatialCoordinate(b.mesh.dolfinx), ufl))
            self.exact.append(u)
            f = fem.assemble_vector(fem.form(-ufl.inner(ufl.div(stress(u)), ufl.TestFunction(b.space)) * ufl.dx))
            f.scatter_reverse(la.InsertMode.add)
            self.loads.append(f.array[: 2 * b.n].copy())

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
                squares[i] += b.comm.allreduce(
                    fem.assemble_scalar(fem.form(ufl.inner(e, e) * ufl.dx(degree=8))), op=MPI.SUM
                )
        return np.sqrt(squares)

    def destroy(self):
        [b.destroy() for b in self.bodies]


def errors(degree, n, solution):
    """h, errors of u (L2, H1) and of the traction (H^-1/2, h-weighted L2) on meshes of 7 n and 5 n cells."""
    blocks = ((7 * n, 1.0), (5 * n, 0.0))
    problem = Problem(
        degree, [fmbd.read_gmsh("meshes/block.py", cells=c, origin=(0.0, y)) for c, y in blocks], solution
    )
    found, mu = problem.solve(), problem.glue.multipliers
    lam, traction = found.multipliers[0].reshape(-1, 2), interface_traction(solution)
    weighted = np.sqrt(1 / (7 * n)) * l2_error(mu, lam, traction)
    out = (1 / (7 * n), *problem.errors(found), DualNorm(mu, times=2).error(lam, traction), weighted)
    problem.destroy()
    return out


def interface_traction(solution):
    """The exact multiplier at y = 1: minus the stress on the upper block's outward normal (0, -1), by complex steps."""

    def value(x):
        def derivative(k):
            z = x.T.astype(complex)
            z[k] += 1e-30j
            return np.stack(np.broadcast_arrays(*solution(z, Numpy)), 1).imag / 1e-30

        g = np.stack([derivative(0), derivative(1)], 2)
        s = MU * (g + g.swapaxes(1, 2)) + LAMBDA * np.trace(g, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        return s[:, :, 1]

    return value


def l2_error(mu, lam, exact):
    from fmbd_fenicsx.traces.traces import quadrature, shape_functions

    q, w = quadrature(1, 8)
    found = np.einsum("qa,fac->fqc", shape_functions(1, mu.degree, q), mu.coefficients(lam))
    e = found - exact(mu.trace.place(q).reshape(-1, 2)).reshape(found.shape)
    return np.sqrt(np.einsum("f,q,fqc->", mu.trace.sizes, w, e**2))


if __name__ == "__main__":
    args = demo.arguments(__doc__)
    checks = []
    for degree in (1, 2):
        h, *patch = errors(degree, 1, PATCH)
        checks.append(demo.Check(f"P{degree} patch test, u and traction", max(patch), 0.0, 1e-12))
        table = np.array([errors(degree, n, BEND) for n in ((1, 2, 4) if args.fast else (1, 2, 4, 8))])
        orders = np.log(table[:-1, 1:] / table[1:, 1:]) / np.log(2)
        demo.say(
            f"P{degree}:  h, u L2, u H1, traction H^-1/2, traction L2 h^1/2\n{np.array2string(table, precision=3)}"
            f"\norders\n{orders.round(2)}"
        )
        for name, got, least in zip(
            ("u L2", "u H1", "traction H^-1/2", "traction L2"),
            orders[-1],
            (degree + 1, degree, degree, degree),
            strict=True,
        ):
            checks.append(demo.Check(f"P{degree} order of {name} at least {least}", min(got, least), least, 0.1))
        if args.picture is not None and MPI.COMM_WORLD.rank == 0:
            import matplotlib.pyplot as plt

            for k, name in enumerate(("u, L2", "u, H1", "traction, H$^{-1/2}$", "traction, h$^{1/2}$ L2")):
                style, label = ("o-", f"P1 {name}") if degree == 1 else ("s--", f"P2 {name}")
                label += f": order {orders[-1, k]:.2f}"
                plt.figure(1, figsize=(8, 4.8), layout="constrained")
                plt.loglog(table[:, 0], table[:, 1 + k], style, label=label, color=f"C{k}")
    if args.picture is not None and MPI.COMM_WORLD.rank == 0:
        plt.title("two tied blocks, meshes that do not match"), plt.grid(alpha=0.3)
        (
            plt.xlabel("cell size of the upper block, m"),
            plt.ylabel("error"),
            plt.figlegend(loc="outside right center", fontsize=8),
        )
        plt.savefig(args.picture, dpi=110)
    demo.finish(checks, None, args)
