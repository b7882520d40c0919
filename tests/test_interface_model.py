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
            assert np.array_equal(getattr(again, name), value), name
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


def stacked(vectors: Any) -> Any:
    """Matrices of the cross products of n points under each other, (3 n, 3)."""
    from fmbd_fenicsx.rotations import hat

    return np.concatenate([hat(x) for x in np.reshape(vectors, (-1, 3))])


@pytest.mark.serial
def test_exudyn_gets_the_integrals_of_nodal_sums() -> None:
    """Against the sums over nodes that Exudyn itself takes of a finite element model."""
    from fmbd_fenicsx.mechanics.reduction.reduced import ReducedConstants, constants_of
    from fmbd_fenicsx.post.exchange.exudyn_file import _integrals

    n, m = 5, 3
    rng = np.random.default_rng(1)
    A = rng.normal(size=(n, n))
    mass = A @ A.T + n * np.eye(n)
    Z = rng.normal(size=(n, 3, m + 1))
    S, T = constants_of(Z, np.tensordot(mass, Z, 1))
    found = _integrals(ReducedConstants(float(mass.sum()), S, T, np.eye(m), np.zeros((m, m)), {}, np.zeros(3), 1.0))

    M, X = np.kron(mass, np.eye(3)), Z[:, :, 0].ravel()
    psi = Z[:, :, 1:].reshape(3 * n, m)
    tilde_x, tilde = stacked(X), np.concatenate([stacked(column) for column in psi.T], axis=1)
    ones = np.kron(np.ones((n, 1)), np.eye(3))
    wanted = {
        "Mtt": ones.T @ M @ ones,
        "chiU": ones.T @ M @ X / mass.sum(),
        "inertiaLocal": tilde_x.T @ M @ tilde_x,
        "massMatrixReduced": psi.T @ M @ psi,
        "mPsiTildePsi": tilde.T @ M @ psi,
        "mPsiTildePsiTilde": tilde.T @ M @ tilde,
        "mPhitTPsi": ones.T @ M @ psi,
        "mPhitTPsiTilde": ones.T @ M @ tilde,
        "mXRefTildePsi": tilde_x.T @ M @ psi,
        "mXRefTildePsiTilde": tilde_x.T @ M @ tilde,
    }
    for name, value in wanted.items():
        assert np.allclose(found[name], value, rtol=1e-12, atol=1e-11), name


@pytest.mark.serial
def test_exudyn_nodes_move_with_their_interface(
    rod_mesh: Callable[..., Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Seven nodes of each interface: their mean and their rotation are those of the surface, mode by mode."""
    body = arm(rod_mesh(dim=3, h=0.25), 2)
    model = fmbd.interface_model(body, ("pin", "tip"))
    with caplog.at_level("WARNING"):
        file = model.save_exudyn(tmp_path / "arm.npz")
    assert "massProportionalDamping=0, stiffnessProportionalDamping=0.001 " in caplog.text
    with np.load(file, allow_pickle=True) as found:
        nodes, modes = found["xRef"].reshape(2, 7, 3), found["modeBasis"].reshape(2, 7, 3, -1)
        assert found["trigList"].max() == 13
    assert np.allclose(nodes.mean(1) + model.center, model.origins)

    motion = model.motion.reshape(2, 2, 3, -1)
    assert np.allclose(modes.mean(1), motion[:, 0])
    arms = nodes[:, 1:] - nodes[:, :1]
    turned = np.cross(arms[..., None], modes[:, 1:], axis=2).sum(1) / (4 * (arms[0, 0] @ arms[0, 0]))
    assert np.allclose(turned, motion[:, 1], atol=1e-9 * np.abs(motion).max())


@pytest.mark.serial
def test_what_exudyn_cannot_hold_is_refused(rod_mesh: Callable[..., Any], tmp_path: Path) -> None:
    from dataclasses import replace

    flat = fmbd.interface_model(arm(rod_mesh(dim=2, h=0.25), 2), ("pin", "tip"))
    with pytest.raises(InputError, match="spatial, this one is plane"):
        flat.save_exudyn(tmp_path / "arm.npz")
    model = fmbd.interface_model(arm(rod_mesh(dim=3, h=0.25), 2), ("pin", "tip"))
    assert model.body is not None
    odd = np.diag(np.arange(1.0, len(model.body.K) + 1))
    for changed, message in (
        ({"stiffening": np.zeros((12, *odd.shape))}, "no geometric stiffening"),
        ({"D": odd}, "damping a M . b K only"),
    ):
        with pytest.raises(InputError, match=message):
            replace(model, body=replace(model.body, **changed)).save_exudyn(tmp_path / "arm.npz")
    with pytest.raises(InputError, match="at rest only"):
        replace(model, body=None).save_exudyn(tmp_path / "arm.npz")
    with pytest.raises(InputError, match="must end in .npz"):
        model.save_exudyn(tmp_path / "arm.mat")
