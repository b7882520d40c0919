"""Two tied blocks, the lower one held at its floor: systems for the tests of linear solvers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.traces.mortar import mortar
from fmbd_fenicsx.fem.traces.multipliers import default_space
from fmbd_fenicsx.fem.traces.traces import trace_of
from fmbd_fenicsx.linear.saddle.elastic import Elastic
from fmbd_fenicsx.linear.saddle.saddle import SaddlePoint
from fmbd_fenicsx.linear.saddle.ties import hold, tie

ROOT = Path(__file__).resolve().parents[1]


def block(name: str, dim: int, cells: int, degree: int, low: float = 0.0, **law: float) -> Field:
    """A unit block whose lower face is at y = low."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * dim, cells=cells, origin=(0.0, low, 0.0)[:dim])
    forms = ElasticForms(
        fmbd.materials.linear_elastic(law.get("E", 1.0), law.get("nu", 0.3)), law.get("rho", 1.0), degree
    )
    return Field(name, mesh, forms)


def surface(field: Field, name: str) -> Any:
    """Trace of a field."""
    return trace_of(field.space, field.mesh, name)


def tied(
    cells: int = 8, dim: int = 2, degree: int = 2, step: float | None = 1.0, space: Any = None, **upper: float
) -> SaddlePoint:
    """The tied blocks for a step of ``step`` cells (None: statics)."""
    other = max(2, 3 * cells // 4)
    space = space or default_space(degree)
    A, B = (
        block("upper", dim, cells, degree, 1.0, **upper),
        block("lower", dim, other, degree, nu=upper.get("nu", 0.3)),
    )
    glue = tie("glue", 0, 1, mortar(surface(A, "bottom"), surface(B, "top"), space))
    floor = hold("floor", 1, space.on(surface(B, "bottom")))
    cm = 0.0 if step is None else 4 * (cells / step) ** 2
    return SaddlePoint([Elastic(A, cm), Elastic(B, cm)], [glue, floor])


def manufactured(s: SaddlePoint) -> tuple[list[Any], list[Any], Any]:
    """Loads and data of a rough exact solution that does not depend on the ranks, and a function measuring
    errors."""
    u = []
    for e in s.elastic:
        x = e.body.X_world
        u.append(
            np.stack(
                [np.sin(1e3 * (1 + k) * (x @ np.arange(1, x.shape[1] + 1) + k)) for k in range(x.shape[1])], 1
            ).ravel()
        )
    rng = np.random.default_rng(0)
    lam = [rng.standard_normal(t.rows) for t in s.ties]
    x = s.vector(u, lam)
    b = x.duplicate()
    s.matrix.mult(x, b)
    f, g = s.blocks(b)
    x.destroy(), b.destroy()

    def error(found: Any) -> float:
        worst = 0.0
        for e, a, c in zip(s.elastic, found.u, u, strict=True):
            d2, c2 = e.body.total(np.array([(a - c) @ (a - c), c @ c]))
            worst = max(worst, float(np.sqrt(d2 / c2)))
        return worst

    return f, g, error


def release(s: SaddlePoint) -> None:
    """Free everything."""
    s.destroy()
    for e in s.elastic:
        e.body.destroy()
