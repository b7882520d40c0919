"""A reduced body for other programs: mass and stiffness on the motions of its interfaces and on modes with fixed interfaces.

The reduced body has n coordinates x = (twist of its frame, modal amplitudes) with M and K at rest. The mean translations and
rotations of k interface surfaces are linear in them, y = B x. With N a basis of the null space of B,

    x = T (y, z),   T = [X - N (N^T K N)^-1 N^T K X,  N Z],   B X = 1,    N^T K N Z = N^T M N Z diag(omega^2)            (1)

which is the form of Craig and Bampton, doi:10.2514/3.4741: K = diag(K_yy, omega^2), and the modes z have unit mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...checks import typed
from ...errors import InputError, require
from ...mechanics.bodies.stored import StoredBody, packed, unpacked
from ...mechanics.placements import FrameMotion
from ...mechanics.reduction.craig_bampton import ReducedBody
from ...mechanics.reduction.reduced import ReducedConstants
from ...ranks import on_root
from ...rotations import Array
from ...system.scene.scene import Scene
from ...system.sensors.sensors import position
from .files import write_whole

SMALLEST = 1e-9  # of the largest singular value: less means that the body cannot move its interfaces apart
KINDS = (".npz", ".mat")


@dataclass(frozen=True)
class InterfaceModel:
    """Matrices (n, n) of a reduced body in the order of Simscape's reduced-order flexible solid, SI units, axes of the mesh.

    Of each interface three translations, then three rotations (in the plane two and one); then ``omega.size`` modes with fixed
    interfaces.

    Attributes: ``M``, ``K``, ``D`` mass, stiffness, damping; ``interfaces`` their names; ``origins`` (k, d) m, centres of the
    surfaces; ``omega`` (rad/s) of the modes; ``mass`` kg; ``center`` (d,) centre of mass, m; ``body``: the constants of the
    reduced body itself, with the inertia of large rotations, for :func:`read_reduced`; ``motion`` (6 k or 3 k, m): mean
    translations (m) and rotations (rad) of the interfaces by unit amplitudes of its m modes, in its axes.
    """

    M: Array
    K: Array
    D: Array
    interfaces: tuple[str, ...]
    origins: Array
    omega: Array
    mass: float
    center: Array
    body: ReducedConstants | None = field(default=None, repr=False)
    motion: Array | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        names = ", ".join(self.interfaces)
        return f"<InterfaceModel of {len(self.M)} freedoms: interfaces {names}; {self.omega.size} modes; {self.mass:.6g} kg>"

    def save(self, file: str | Path) -> Path:
        """Write all of it to a ``.npz`` (NumPy) or ``.mat`` (MATLAB: M, K, D, origins, ...) file; rank 0 writes.

        Raises:
            InputError: another ending, or a body with loads.
        """
        from mpi4py import MPI

        file = Path(file)
        require(
            file.suffix in KINDS, f'Interface model "{file}": the name must end in .npz or .mat, found "{file.suffix}".'
        )
        given = {name: value for name, value in vars(self).items() if name != "body" and value is not None}
        content: dict[str, Any] = {name: np.asarray(value) for name, value in given.items()}
        content |= {} if self.body is None else packed(self.body, file.stem)

        def write(place: Path) -> None:
            if file.suffix == ".npz":
                np.savez(place, **content)
                return
            from scipy.io import savemat

            names = {
                key: np.array(list(content[key]), dtype=object)
                for key in ("interfaces", "body_surfaces")
                if key in content
            }
            savemat(place, content | names)

        on_root(MPI.COMM_WORLD, lambda: write_whole("The body", file, write))
        return file

    def save_exudyn(self, file: str | Path) -> Path:
        """Write the body for Exudyn's floating frame of reference object: ``.npz``; rank 0 writes.

            fmbd.interface_model(arm, ("pin", "tip")).save_exudyn("arm.npz")

        There, without this package (positionRef: ``model.center`` of the body as it was meshed; interface k has the nodes 7 k
        to 7 k + 6 with equal weights, 7 k is its centre):

            body = exudyn.FEM.ObjectFFRFreducedOrderInterface()
            body.LoadFromFile("arm.npz")
            found = body.AddObjectFFRFreducedOrder(mbs, positionRef=[0.5, 0, 0], gravity=[0, 0, -9.81])

        Raises:
            InputError: another ending; a plane body, or one with loads, with geometric stiffening, with damping other than
                a M + b K; a model read from a file without the inertia of large rotations.
        """
        from .exudyn_file import save_exudyn

        return save_exudyn(self, file)


def load_interface_model(file: str | Path) -> InterfaceModel:
    """Read what :meth:`InterfaceModel.save` wrote, ``.npz`` or ``.mat``.

    Raises:
        InputError: no such file, or one with other content.
    """
    try:
        found = _content(Path(file))
        k = len(names := tuple(str(n) for n in _strings(found["interfaces"])))

        return InterfaceModel(
            M=found["M"],
            K=found["K"],
            D=found["D"],
            interfaces=names,
            # MATLAB knows no vectors: shapes are given back
            origins=np.reshape(found["origins"], (k, -1)),
            omega=np.ravel(found["omega"]),
            mass=float(np.ravel(found["mass"])[0]),
            center=np.ravel(found["center"]),
            body=unpacked(found) if "body_T" in found else None,
            motion=found.get("motion"),
        )
    except (OSError, KeyError, ValueError, TypeError, IndexError) as error:
        raise InputError(f"{file} is no interface model written by .save(...): {error}") from None


@typed
def read_reduced(file: str | Path, name: str) -> StoredBody:
    """The reduced body behind a saved interface model, as a body of a scene, without its mesh.

        arm = fmbd.read_reduced("arm.npz", "arm")
        scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm.surface("pin"), center=(0, 0, 0)))

    It moves as the body that was saved, to roundoff, and starts at rest where that one lay. All of its surfaces are there;
    what needs the mesh (pictures of its shape, stresses, contact) is not.

    Raises:
        InputError: no such file, or one with matrices at rest alone: from them the inertia of large rotations cannot be had.
    """
    model = load_interface_model(file)
    if model.body is None:
        raise InputError(
            f"{file} holds M, K and D at rest only; a body that turns needs its inertia tensors as well, which "
            "fmbd.interface_model(body, ...).save(...) writes beside them."
        )
    return StoredBody(name, model.body)


def _content(file: Path) -> dict[str, Any]:
    """All arrays of a file by name."""
    if file.suffix == ".mat":
        from scipy.io import loadmat

        return {key: _strings(x) if x.dtype == object else x for key, x in loadmat(file).items() if key[0] != "_"}
    with np.load(file) as found:
        return {name: found[name] for name in found.files}


def _strings(x: Any) -> Any:
    """Names, each in an array of its own in MATLAB's files."""
    return [str(np.ravel(one)[0]) if isinstance(one, np.ndarray) else str(one) for one in np.ravel(x)]


def interface_model(body: ReducedBody, interfaces: Sequence[str]) -> InterfaceModel:
    """The matrices (1) of a reduced body on some of its surfaces; collective.

        arm = rod.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 10))
        fmbd.interface_model(arm, ("pin", "tip")).save("arm.mat")

    Raises:
        InputError: no reduced body, an unknown surface, or modes that cannot move the interfaces independently.
    """
    require(isinstance(body, ReducedBody), f"interface_model takes body.reduced(...), found {body!r}.")
    names = tuple(interfaces)
    require(len(names) > 0, f'Body "{body.name}": name at least one surface as interface.')
    part, B, M = _coordinates(body, names)
    n = len(M)
    frame = len(M) - part.n
    K, D = np.zeros((2, n, n))
    K[frame:, frame:], D[frame:, frame:] = part.constants.K, part.constants.D

    T, omega = _basis(body.name, names, (B, M, K))
    c = part.constants
    origins = np.array([c.surfaces[name].center for name in names])
    M, K, D = (0.5 * (A + A.T) for A in (T.T @ M @ T, T.T @ K @ T, T.T @ D @ T))
    known = (names, origins, omega, float(c.mass), np.array(c.center))
    return InterfaceModel(M, K, D, *known, body=c, motion=B[:, frame:])


def _coordinates(body: ReducedBody, names: tuple[str, ...]) -> tuple[Any, Array, Array]:
    """The part, B (1) and the mass matrix of frame and modes, at rest in the undeformed state; collective."""
    scene = Scene(f"interfaces of {body.name}")
    scene.add(body)
    for name in names:
        scene.sensor(name, position(body.surface(name)))
    system, state, markers = scene.build()
    part: Any = system.parts[0]

    # undeformed, in the axes of the mesh
    m = system.motions
    q = np.zeros(system.n_q)
    q[: m.n_pose] = m.pose(part.constants.center, None)
    ev = system.at(0.0, q, np.zeros(system.n_v))
    rows = []
    for name in names:
        marker = markers[name]
        on = int(np.flatnonzero(system.markers.surface == marker)[0])
        by_modes = ev.kin.jac_port[on] @ part.port_matrix[system.markers.port[on]]
        rows.append(np.concatenate((ev.kin.jac_frame[marker], by_modes), axis=1))

    rest = FrameMotion(0.0, np.eye(m.dim), np.zeros(m.n_twist), np.zeros(m.n_twist), np.zeros(m.dim))
    of_frame, low, of_modes = part.mass_blocks(rest, np.zeros(part.n))
    return part, np.concatenate(rows), np.block([[of_frame, low.T], [low, of_modes]])


def _basis(name: str, interfaces: tuple[str, ...], matrices: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """T and omega of (1)."""
    import scipy.linalg as sl

    B, M, K = matrices
    count, n = B.shape
    U, s, Vt = np.linalg.svd(B / np.abs(B).max(axis=1, keepdims=True))
    if count > n or s[-1] < SMALLEST * s[0]:
        raise InputError(
            f'Body "{name}": its modes cannot move the interfaces {", ".join(interfaces)} independently. '
            f"Reduce it with basis=fmbd.CraigBampton({interfaces}, modes)."
        )
    # what leaves the interfaces where they are, and the least that moves each of them
    N = Vt[count:].T
    X = np.linalg.pinv(B)

    soft = N.T @ K @ N
    static = X - N @ np.linalg.solve(soft, N.T @ K @ X) if N.size else X
    # vibrations with the interfaces held
    square, Z = sl.eigh(soft, N.T @ M @ N) if N.size else (np.zeros(0), np.zeros((0, 0)))
    return np.concatenate((static, N @ Z), axis=1), np.sqrt(square)
