"""Reduced bodies for other programs: the matrices keep frequencies, stiffness and rigid motion of the body."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import linear_elastic


def arm(mesh: Any, count: int = 6) -> Any:
    rod = fmbd.FloatingBody("arm", mesh, density=1000.0, elastic=linear_elastic(5e6, 0.3), stiffness_damping=1e-3)
    return rod.reduced(basis=fmbd.CraigBampton(("pin", "tip"), count))


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_matrices_are_those_of_the_body(rod_mesh: Callable[..., Any], dim: int) -> None:
    body = arm(rod_mesh(dim=dim, h=0.25))
    model = fmbd.interface_model(body, ("pin", "tip"))
    each, n = 3 if dim == 2 else 6, len(model.M)

    # free vibrations: rigid motions, and the frequencies of the reduced body
    square = sl.eigh(model.K, model.M, eigvals_only=True)
    assert np.abs(square[:each]).max() < 1e-8 * square[each]
    assert np.allclose(np.sqrt(square[each:]), np.sort(body.reduction.omega), rtol=1e-8)
    assert np.allclose(np.diag(model.K)[2 * each :], model.omega**2)
    assert np.allclose(model.K[: 2 * each, 2 * each :], 0, atol=1e-9 * np.abs(model.K).max())

    # a rigid motion has no strain and the mass of the body: along x, and about the pin
    push, turn = np.zeros((2, n))
    push[[0, each]] = 1.0
    turn[[each - 1, 2 * each - 1]] = 1.0
    turn[each + 1] = model.origins[1, 0] - model.origins[0, 0]  # the tip moves across
    for rigid in (push, turn):
        assert np.linalg.norm(model.K @ rigid) < 1e-8 * np.abs(model.K).max()
    assert push @ model.M @ push == pytest.approx(model.mass, rel=1e-12)
    length, height = 1.0, 0.1
    exact = model.mass * (length**2 + height**2) / 12 + model.mass * (length / 2) ** 2
    assert turn @ model.M @ turn == pytest.approx(exact, rel=1e-6)
    assert np.allclose(model.D, 1e-3 * model.K, atol=1e-9 * np.abs(model.K).max())


def test_clamped_arm_sags_as_in_a_scene(rod_mesh: Callable[..., Any]) -> None:
    """Stiffness on the tip, the pin clamped, against the equilibrium of the body itself."""
    body = arm(rod_mesh(dim=2, h=0.25))
    model = fmbd.interface_model(body, ("pin", "tip"))
    sag = np.linalg.solve(model.K[3:6, 3:6], (0.0, 1e-3, 0.0))
    scene = fmbd.Scene("clamped")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("pin"), center=(0, 0)))
    scene.add(fmbd.force("pull", body.surface("tip"), lambda t: (0.0, 1e-3)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    assert fmbd.equilibrium(scene)["tip"][1] == pytest.approx(sag[1], rel=1e-5)


@pytest.mark.serial
def test_files_hold_all_of_it(rod_mesh: Callable[..., Any], tmp_path: Path) -> None:
    from scipy.io import loadmat

    model = fmbd.interface_model(arm(rod_mesh(dim=3, h=0.25), 2), ("pin", "tip"))
    again = fmbd.load_interface_model(model.save(tmp_path / "arm.npz"))
    for name, value in vars(model).items():
        if name != "body":  # see the motion of the body below
            assert np.array_equal(getattr(again, name), value)
    found = loadmat(model.save(tmp_path / "arm.mat"))
    assert np.array_equal(found["K"], model.K) and np.array_equal(found["origins"], model.origins)
    with pytest.raises(InputError, match=r"must end in .npz or .mat"):
        model.save(tmp_path / "arm.txt")
    (tmp_path / "bad.npz").write_text("no model")
    with pytest.raises(InputError, match="no interface model"):
        fmbd.load_interface_model(tmp_path / "bad.npz")


def test_what_cannot_be_exported_is_refused(rod_mesh: Callable[..., Any]) -> None:
    rod = fmbd.FloatingBody("arm", rod_mesh(dim=2, h=0.25), density=1.0, elastic=linear_elastic(1.0, 0.3))
    with pytest.raises(InputError, match="cannot move the interfaces pin, tip independently.*CraigBampton"):
        fmbd.interface_model(rod.reduced(modes=1), ("pin", "tip"))
    with pytest.raises(InputError, match="takes body.reduced"):
        fmbd.interface_model(rod, ("pin",))
    with pytest.raises(InputError, match='no surface "tp"'):
        fmbd.interface_model(rod.reduced(modes=3), ("tp",))


@pytest.mark.serial
@pytest.mark.parametrize(("dim", "ending"), [(2, ".npz"), (3, ".mat")])
def test_a_body_read_back_moves_as_the_one_saved(
    rod_mesh: Callable[..., Any], tmp_path: Path, dim: int, ending: str
) -> None:
    body = arm(rod_mesh(dim=dim, h=0.25), 4)
    file = fmbd.interface_model(body, ("pin", "tip")).save(tmp_path / f"arm{ending}")

    def swing(rod: Any) -> Any:
        scene = fmbd.Scene("swing", gravity=(0, -9.81, 0))
        pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0), axis=(0, 0, 1))
        scene.add(rod, pin)
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        scene.sensor("pin", fmbd.reaction("pin"))
        return fmbd.solve(scene, t_end=0.3, dt=5e-3, output=fmbd.Output(snapshots=2))

    saved, again = swing(body), swing(fmbd.read_reduced(file, "arm"))
    assert np.abs(saved["tip"][-1] - saved["tip"][0]).max() > 0.1
    assert np.abs(again["tip"] - saved["tip"]).max() < 1e-12
    assert np.allclose(again["pin"], saved["pin"], rtol=1e-9, atol=1e-8)
    assert again.total_energy == pytest.approx(saved.total_energy, rel=1e-9, abs=1e-9)
    again.picture(tmp_path / "arm.png")


@pytest.mark.serial
def test_what_cannot_be_read_as_a_body_is_refused(rod_mesh: Callable[..., Any], tmp_path: Path) -> None:
    from dataclasses import replace

    model = fmbd.interface_model(arm(rod_mesh(dim=2, h=0.25), 2), ("pin", "tip"))
    bare = replace(model, body=None).save(tmp_path / "bare.npz")
    with pytest.raises(InputError, match="at rest only"):
        fmbd.read_reduced(bare, "arm")
    again = fmbd.read_reduced(model.save(tmp_path / "arm.npz"), "arm")
    with pytest.raises(InputError, match='has no surface "tp".*tip'):
        again.surface("tp")
    scene = fmbd.Scene("bare body")
    scene.add(again)
    with pytest.raises(InputError, match="attach to a surface"):
        scene.sensor("arm", fmbd.position(again))
        scene.build()
