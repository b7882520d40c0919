"""Two tied blocks, the lower one held at its floor, and chains of them: systems for the tests of linear solvers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.analysis.statics.search import long_step
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Ends, default_space
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver

ROOT = Path(__file__).resolve().parents[1]
KEPT1 = Continuous(1, Ends.KEPT)


def block(name: str, dim: int, cells: int, degree: int, low: float = 0.0, **law: Any) -> fmbd.AbsoluteBody:
    """A unit block whose lower face is at y = low."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * dim, cells=cells, origin=(0.0, low, 0.0)[:dim])
    elastic = fmbd.materials.linear_elastic(law.get("E", 1.0), law.get("nu", 0.3))
    given = {"density": law.get("rho", 1.0), "loads": law.get("loads", ())}
    return fmbd.AbsoluteBody(name, mesh, degree=degree, elastic=elastic, **given)


def unit_field(dim: int, cells: int, degree: int) -> Field:
    """The field of a unit block by itself."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * dim, cells=cells)
    return Field("block", mesh, ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, degree))


class Step:
    """The matrix cm M + K of a scene of absolute bodies, with its constraints; cm = None: statics."""

    def __init__(self, *parts: Any, cm: float | None) -> None:
        scene = fmbd.Scene("tied")
        scene.add(*parts)
        self.system, start, _ = scene.build()
        if cm is None:
            cm = long_step(self.system, start, None, balanced=False) ** -2
        self.weights = Weights(cm, 0.0, 1.0)
        self.ev = self.system.at(0.0, start.q, start.v)
        self.fields = [p.field for _, p in self.system.fields]

    def manufactured(self) -> tuple[Any, Any]:
        """Loads and data of a rough exact solution that does not depend on the ranks."""
        rough = lambda x, k: np.sin(1e3 * (1 + k) * (x @ np.arange(1, x.shape[1] + 1) + k))
        self.exact = [np.stack([rough(f.X_world, k) for k in range(f.dim)], 1) for f in self.fields]
        lam = np.random.default_rng(0).standard_normal(self.system.n_lam)
        pairs = zip(self.fields, self.exact, strict=True)
        forces = [self.weights.cm * f.mass(u).ravel() + f.stiffness(u.ravel()) for f, u in pairs]
        G, x = self.ev.jacobian, np.concatenate([u.ravel() for u in self.exact])
        return np.concatenate(forces) + G.transposed(lam), G.times(x)

    def solve(self, preset: Any, b: Any, c: Any) -> tuple[Any, int]:
        """Motion like v for forces b and openings c, and the iterations on multipliers or on the whole."""
        solver = StepSolver(self.system, linear=preset, prefix="tied_")
        solver.prepare(self.ev, self.weights)
        x, _ = solver.solve(b, c)
        counts = solver.counters["tie_iterations"] + solver.counters["saddle_iterations"]
        solver.destroy()
        return x, int(counts)

    def tried(self, preset: Any) -> tuple[int, float]:
        """Iterations for :meth:`manufactured`, and the largest error of a body."""
        x, count = self.solve(preset, *self.manufactured())
        worst = 0.0
        for k, (field, exact) in enumerate(zip(self.fields, self.exact, strict=True)):
            off = self.system.local_v(x, k).reshape(-1, field.dim) - exact
            squares = field.total(np.array([(off**2).sum(), (exact**2).sum()]))
            worst = max(worst, float(np.sqrt(squares[0] / squares[1])))
        return count, worst


def tied(
    cells: int = 8, dim: int = 2, degree: int = 2, step: float | None = 1.0, space: Any = None, **upper: float
) -> Step:
    """The tied blocks for a step of ``step`` cells (None: statics)."""
    space = space or default_space(degree)
    A = block("upper", dim, cells, degree, 1.0, **upper)
    B = block("lower", dim, max(2, 3 * cells // 4), degree, nu=upper.get("nu", 0.3))
    glue = fmbd.tie_surface("glue", A.surface("bottom"), B.surface("top"), space=space)
    floor = fmbd.tie_surface("floor", B.surface("bottom"), fmbd.ground, space=space)
    return Step(A, B, glue, floor, cm=None if step is None else 4 * (cells / step) ** 2)


def chain(links: int) -> Step:
    """Blocks on top of each other, tied; the lowest is held."""
    bodies = [block(f"link{i}", 2, 6 if i % 2 else 4, 2, float(i)) for i in range(links)]
    ties = [fmbd.tie_surface("floor", bodies[0].surface("bottom"), fmbd.ground, space=KEPT1)]
    for i in range(1, links):
        sides = bodies[i].surface("bottom"), bodies[i - 1].surface("top")
        ties.append(fmbd.tie_surface(f"glue{i}", *(sides if i % 2 else sides[::-1]), space=KEPT1))
    return Step(*bodies, *ties, cm=4 * 36.0 / 10.0)
