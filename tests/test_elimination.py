"""Dual multipliers eliminated locally against the direct solution of the saddle point."""

from __future__ import annotations

import numpy as np
import pytest
from tied import block, manufactured, release, surface, tied

from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Dual, Ends
from fmbd_fenicsx.linear.presets.elimination import Eliminated
from fmbd_fenicsx.linear.presets.krylov import Direct
from fmbd_fenicsx.linear.saddle.saddle import Elastic, SaddlePoint, hold


@pytest.mark.mpi
@pytest.mark.parametrize("ends", [Ends.MERGED, Ends.DROPPED])
@pytest.mark.parametrize("dim, degree, cells", [(2, 1, 8), (2, 2, 6), (3, 1, 4)])
def test_same_solution_without_multipliers_in_the_system(dim: int, degree: int, cells: int, ends: Ends) -> None:
    s = tied(cells, dim, degree, space=Dual(ends))
    f, g, error = manufactured(s)
    solver, direct = Eliminated().solver(s), Direct().solver(s)
    found, wanted = solver.solve(f, g), direct.solve(f, g)
    assert error(found) < 1e-9
    for a, b in zip(found.multipliers, wanted.multipliers, strict=True):
        assert np.abs(a - b).max() < 1e-8 * np.abs(b).max()
    total = sum(e.body.dim * e.body.space.dofmap.index_map.size_global for e in s.elastic)
    assert solver.A.getSize()[0] == total - s.n_multipliers  # each multiplier takes one displacement with it
    assert solver.A.isSymmetric(1e-10)
    solver.destroy(), direct.destroy()
    release(s)


def test_other_spaces_and_shared_nodes_are_refused() -> None:
    s = tied(4, degree=1, space=Continuous())
    with pytest.raises(InputError, match='Tie "glue": 3 multipliers .* have no inner node of their own'):
        Eliminated().solver(s)
    release(s)
    field = block("b", 2, 4, 1)
    mu = Dual().on(surface(field, "left"))
    s = SaddlePoint([Elastic(field, 1.0)], [hold("one", 0, mu), hold("two", 0, mu)])
    with pytest.raises(InputError, match='Ties "one" and "two" share nodes'):
        Eliminated().solver(s)
    release(s)
