"""The driver's library: all its units compile, and a system gets those that it needs."""

from __future__ import annotations

import pytest
from test_driver import bushings, links, tyre
from test_kernel import flexible

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import kernel_cache
from fmbd_fenicsx.system.compiled.library import CONTACT, driver_library, units_of

pytestmark = pytest.mark.skipif(kernel_cache.compiler() is None, reason="no C compiler")


@pytest.mark.parametrize("dim", [2, 3])
def test_all_units_compile(dim: int) -> None:
    """A unit with an error would let everything run in NumPy."""
    rods = ("rods",) if dim == 3 else ()
    assert driver_library(dim) is not None
    assert driver_library(dim, ("reduced", "fields", *rods, "mounts", "whole", CONTACT)) is not None


def test_a_scene_gets_the_units_that_it_needs() -> None:
    def units(scene: fmbd.Scene) -> tuple[str, ...]:
        return units_of(scene.build()[0])

    assert units(links(2, 3)) == ()
    assert units(bushings(3)) == ("mounts",)
    assert units(flexible(3)) == ("reduced",)
    assert units(tyre(3)) == ("whole",)
