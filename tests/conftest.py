"""Shared fixtures: meshes built once a session, one temporary folder for all ranks, collective teardown."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fmbd_fenicsx.kernel_cache import compiler
from fmbd_fenicsx.ranks import world_size

ROOT = Path(__file__).resolve().parents[1]


def pytest_configure(config: pytest.Config) -> None:
    """One deterministic hypothesis profile: the same examples on all ranks."""
    try:
        from hypothesis import settings
    except ImportError:
        return
    settings.register_profile("fmbd", derandomize=True, deadline=None, database=None, max_examples=30)
    settings.load_profile("fmbd")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """What cannot be tested here. Code that does not compile is no reason: it would run in NumPy."""
    if item.get_closest_marker("compiled") is not None and compiler() is None:
        pytest.skip("no C compiler")
    # tests that start programs of their own or count processes make no sense under mpirun
    if world_size() > 1 and item.get_closest_marker("serial") is not None:
        pytest.skip("for one rank only")


@pytest.fixture(autouse=True)
def collective_teardown() -> Iterator[None]:
    """Collect young garbage on all ranks at the same moment: freeing a PETSc object is collective."""
    yield
    if world_size() == 1:
        return
    gc.collect(0)
    if "mpi4py.MPI" in sys.modules:
        sys.modules["mpi4py.MPI"].COMM_WORLD.barrier()


@pytest.fixture
def shared_tmp(tmp_path: Path) -> Path:
    """A temporary folder, the same on all ranks."""
    if world_size() == 1:
        return tmp_path
    from mpi4py import MPI

    return Path(MPI.COMM_WORLD.bcast(str(tmp_path)))


@pytest.fixture(scope="session")
def rod_mesh() -> Callable[..., Any]:
    """``rod_mesh(dim=2, h=0.1, length=1.0, height=0.1)``: the rod of meshes/rod.py, each size built once."""
    known: dict[tuple[Any, ...], Any] = {}

    def of(dim: int = 2, h: float = 0.1, length: float = 1.0, height: float = 0.1) -> Any:
        from fmbd_fenicsx import read_gmsh

        key = (dim, h, length, height)
        if key not in known:
            known[key] = read_gmsh(ROOT / "meshes/rod.py", dim=dim, h=h, length=length, height=height)
        return known[key]

    return of
