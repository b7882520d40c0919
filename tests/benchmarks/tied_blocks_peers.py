"""The tied blocks of ``tied_blocks.py`` in scikit-fem and in GetFEM; run by that script in the peers' own interpreters.

Argument: a file with the points (2, n) and triangles (3, m) of both blocks, the degree, the peer. Prints one line of JSON: errors
of u in L2 and H1, CPU seconds for assembly and solution (the median of three).
"""

import json
import sys
import time
from statistics import median

import numpy as np

MU, LAMBDA = 1.0 / 2.6, 0.3 / (1.3 * 0.4)  # E = 1, nu = 0.3, plane strain


def exact(x):
    """u and its gradient [i, j] at points x (2, ...)."""
    e, s = np.exp(x[1] / 2) / 5, x[0] + x[1]
    u = np.array([np.sin(2 * x[0]) * e, np.cos(s) * x[1] / 5])
    down = -np.sin(s) * x[1] / 5
    return u, np.array([[2 * np.cos(2 * x[0]) * e, np.sin(2 * x[0]) * e / 2], [down, down + np.cos(s) / 5]])


def force(x):
    """-div sigma(u)."""
    e, s = np.exp(x[1] / 2) / 5, x[0] + x[1]
    c, n = np.cos(s) * x[1] / 5, np.sin(s) / 5
    xx, xy = np.array([-4 * np.sin(2 * x[0]) * e, -c]), np.array([np.cos(2 * x[0]) * e, -c - n])
    yy = np.array([np.sin(2 * x[0]) * e / 4, -c - 2 * n])
    grad_div = np.array([xx[0] + xy[1], xy[0] + yy[1]])
    return -(MU * (xx + yy) + (MU + LAMBDA) * grad_div)


def skfem(meshes, degree):
    """Mortar over the true segments by a supermesh; outer faces eliminated; SuperLU."""
    from scipy.sparse import identity
    from skfem import (
        Basis,
        BilinearForm,
        ElementLineP1,
        ElementTriP1,
        ElementTriP2,
        ElementVector,
        FacetBasis,
        Functional,
        LinearForm,
        MeshLine,
        MeshTri,
        asm,
        bmat,
        condense,
        solve,
    )  # fmt: skip
    from skfem.helpers import ddot, dot, sym_grad, trace
    from skfem.supermeshing import elementwise_quadrature, intersect

    start = time.process_time()
    element = ElementVector({1: ElementTriP1, 2: ElementTriP2}[degree]())
    m = [MeshTri(p, t) for p, t in meshes]
    basis = [Basis(x, element, intorder=6) for x in m]

    @BilinearForm
    def stiffness(u, v, w):
        return 2 * MU * ddot(sym_grad(u), sym_grad(v)) + LAMBDA * trace(sym_grad(u)) * trace(sym_grad(v))

    @LinearForm
    def load(v, w):
        return dot(force(w.x), v)

    on = lambda x: np.abs(x[1] - 1.0) < 1e-9
    lines = [x.trace(on, mtype=MeshLine, project=lambda p: p[:1]) for x in m]  # upper first: it carries the multipliers
    pieces, *owner = intersect(lines[0][0], lines[1][0])
    points = [elementwise_quadrature(lines[k][0], pieces, owner[k], intorder=4) for k in (0, 1)]
    faces = [FacetBasis(m[k], element, facets=lines[k][1][owner[k]], quadrature=points[k]) for k in (0, 1)]
    line = Basis(lines[0][0], ElementVector(ElementLineP1(), 2), elements=owner[0], quadrature=points[0])
    coupling = BilinearForm(lambda u, v, w: dot(u, v))
    B = [asm(coupling, f, line) for f in faces]
    K = [asm(stiffness, b) for b in basis]
    f = np.concatenate([*(asm(load, b) for b in basis), np.zeros(line.N)])
    A = bmat([[K[0], None, B[0].T], [None, K[1], -B[1].T], [B[0], -B[1], None]], "csr")
    x, held, shift = np.zeros(len(f)), [], 0
    for b in basis:
        dofs = b.get_dofs(b.mesh.facets_satisfying(lambda x: ~on(x), boundaries_only=True)).flatten()
        component = np.zeros(b.N, dtype=int)
        component[b.nodal_dofs[1]] = component[b.facet_dofs[1:]] = 1
        x[shift + dofs] = exact(b.doflocs[:, dofs])[0][component[dofs], np.arange(len(dofs))]
        held.append(shift + dofs)
        shift += b.N
    # beside P1 the multipliers at the two ends see held nodes only: merged with their neighbours
    E = merged(line, shift, len(f)) if degree == 1 else identity(len(f), format="csr")
    A, f, x0 = (E.T @ A @ E).tocsr(), E.T @ f, E.T @ x
    y = solve(*condense(A, f, x=x0, D=np.concatenate(held)))
    u = E @ y
    seconds = time.process_time() - start

    @Functional
    def l2(w):
        return ((w["u"] - exact(w.x)[0]) ** 2).sum(0)

    @Functional
    def h1(w):
        return ((w["u"].grad - exact(w.x)[1]) ** 2).sum((0, 1))

    n = basis[0].N
    parts = [b.interpolate(u[s]) for b, s in zip(basis, (slice(0, n), slice(n, n + basis[1].N)), strict=True)]
    errors = [np.sqrt(sum(asm(g, b, u=p) for b, p in zip(basis, parts, strict=True))) for g in (l2, h1)]
    return *errors, seconds


def merged(line, shift, total):
    """Columns without the end multipliers, whose values follow their neighbours."""
    import scipy.sparse as sp

    order = np.argsort(line.mesh.p[0])
    E = sp.identity(total, format="lil")
    drop = []
    for c in (0, 1):
        dof = lambda node, c=c: shift + line.nodal_dofs[c, node]
        for end, near in ((order[0], order[1]), (order[-1], order[-2])):
            E[dof(end), dof(near)] = 1.0
            drop.append(dof(end))
    return E.tocsc()[:, np.setdiff1d(np.arange(total), drop)]


def getfem(meshes, degree):
    """P1 multipliers on the upper face (beside P1 without ends), the lower one interpolated at quadrature points; MUMPS."""
    import getfem as gf

    start = time.process_time()
    md, mims, mfs, made = gf.Model("real"), [], [], []
    for k, (p, t) in enumerate(meshes):
        m = gf.Mesh("empty", 2)
        for tri in t.T:
            m.add_convex(gf.GeoTrans("GT_PK(2,1)"), p[:, tri])
        outer = m.outer_faces()
        glued = np.array([np.abs(m.pts()[1, m.pid_in_faces([[c], [f]])] - 1.0).max() < 1e-9 for c, f in outer.T])
        m.set_region(1, outer[:, glued])
        m.set_region(2, outer[:, ~glued])
        mf = gf.MeshFem(m, 2)
        mf.set_fem(gf.Fem(f"FEM_PK(2,{degree})"))
        mim = gf.MeshIm(m, gf.Integ("IM_TRIANGLE(6)"))
        md.add_fem_variable(f"u{k}", mf)
        md.add_linear_term(mim, f"2*{MU}*(Sym(Grad_u{k}):Sym(Grad_Test_u{k}))+{LAMBDA}*Div_u{k}*Div_Test_u{k}")
        data = gf.MeshFem(m, 2)
        data.set_fem(gf.Fem("FEM_PK(2,4)"))
        nodes = data.basic_dof_nodes()
        md.add_initialized_fem_data(f"f{k}", data, pick(force(nodes)))
        md.add_linear_term(mim, f"-f{k}.Test_u{k}")
        md.add_initialized_fem_data(f"d{k}", mf, pick(exact(mf.basic_dof_nodes())[0]))
        md.add_Dirichlet_condition_with_simplification(f"u{k}", 2, f"d{k}")
        mims.append(mim), mfs.append(mf), made.append(m)
    mult = gf.MeshFem(made[0], 2)
    mult.set_fem(gf.Fem("FEM_PK(2,1)"))
    keep = np.unique(mult.basic_dof_on_region(1))
    if degree == 1:  # without the ends, which see held nodes only
        x = mult.basic_dof_nodes()[0, keep]
        keep = keep[(x > 1e-9) & (x < 1 - 1e-9)]
    md.add_fem_variable("lam", gf.MeshFem("partial", mult, keep))
    md.add_interpolate_transformation_from_expression("t", made[0], made[1], "X")
    md.add_linear_term(mims[0], "lam.(Test_u0-Interpolate(Test_u1,t))+Test_lam.(u0-Interpolate(u1,t))", 1)
    md.solve("lsolver", "mumps")
    seconds = time.process_time() - start
    out = np.zeros(2)
    s = "[sin(2*X(1))*exp(X(2)/2)/5;cos(X(1)+X(2))*X(2)/5]"
    g = (
        "[[2*cos(2*X(1))*exp(X(2)/2)/5,sin(2*X(1))*exp(X(2)/2)/10];"
        "[-sin(X(1)+X(2))*X(2)/5,cos(X(1)+X(2))/5-sin(X(1)+X(2))*X(2)/5]]"
    )
    fine = [gf.MeshIm(m, gf.Integ("IM_TRIANGLE(10)")) for m in made]
    g = g.replace("[[", "[").replace("]]", "]").replace("];[", ";")
    for k, mim in enumerate(fine):
        out[0] += gf.asm_generic(mim, 0, f"Norm_sqr(u{k}-{s})", -1, md)
        out[1] += gf.asm_generic(mim, 0, f"Norm_sqr(Grad_u{k}-{g})", -1, md)
    return (*np.sqrt(out), seconds)


def pick(values):
    """Nodal data of a vector field: component k at the nodes with number k modulo 2."""
    n = values.shape[1]
    return values[np.arange(n) % 2, np.arange(n)]


if __name__ == "__main__":
    file, degree, peer = sys.argv[1:4]
    z = np.load(file)
    meshes = [(z[f"p{k}"], z[f"t{k}"]) for k in (0, 1)]
    runs = [{"skfem": skfem, "getfem": getfem}[peer](meshes, int(degree)) for _ in range(3)]
    print(json.dumps([*(float(x) for x in runs[0][:2]), median(r[2] for r in runs)]))
