"""A reduced body read from a file: its constants without the mesh that they came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError, near
from ...rotations import Array, motions
from ..reduction.reduced import ModalBody, ReducedConstants, SurfaceData
from .bodies import Surface

PLAIN = ("mass", "S", "T", "K", "D", "center", "size")


@dataclass(frozen=True, eq=False)
class StoredBody(ModalBody):
    """A reduced body by its constants; made by :func:`fmbd_fenicsx.read_reduced`. It starts at rest, where it was saved."""

    modal = True

    name: str
    constants: ReducedConstants

    @property
    def dim(self) -> int:  # type: ignore[override]
        """Space dimension."""
        return len(self.constants.S)

    @property
    def may_do_work(self) -> bool:
        """Loads may."""
        return bool(self.constants.loads)

    @property
    def keeps_energy(self) -> bool:
        """Without loads and damping."""
        return not (self.may_do_work or self.constants.D.any())

    def surface(self, name: str) -> Surface:
        """A surface of the body that was saved: what joints, forces and sensors take hold of."""
        known = self.constants.surfaces
        if name not in known:
            raise InputError(f'Body "{self.name}" has no surface "{name}". {near(name, known)}')
        return Surface(self, name)

    def start_twist(self) -> Array:
        """At rest."""
        return np.zeros(motions(self.dim).n_twist)


def packed(constants: ReducedConstants, name: str) -> dict[str, Any]:
    """The constants of body ``name`` as arrays by names that begin with "body_".

    Raises:
        InputError: a body with loads, which are functions of the user's own.
    """
    if constants.loads:
        raise InputError(f'Body "{name}": its loads cannot be kept in a file. Save the body without loads.')
    out = {f"body_{key}": np.asarray(getattr(constants, key)) for key in PLAIN}
    if constants.stiffening is not None:
        out["body_stiffening"] = constants.stiffening

    out["body_surfaces"] = np.array(list(constants.surfaces), dtype=str)
    for i, surface in enumerate(constants.surfaces.values()):
        for key, value in vars(surface).items():
            if value is not None:
                out[f"body_surface{i}_{key}"] = value
    return out


def unpacked(found: dict[str, Any]) -> ReducedConstants:
    """The constants that :func:`packed` made; KeyError where one is missing."""
    d = int(np.asarray(found["body_center"]).size)
    m = int(np.asarray(found["body_T"]).shape[0]) - 1
    names = [str(name).strip() for name in np.ravel(found["body_surfaces"])]

    surfaces = {}
    for i, name in enumerate(names):
        of = f"body_surface{i}_"
        reference = np.reshape(found[of + "reference"], (1 + d, d))
        modes = np.reshape(found[of + "modes"], ((1 + d) * d, m))
        bend = np.reshape(found[of + "bend"], (-1, m, m)) if of + "bend" in found else None
        surfaces[name] = SurfaceData(reference, modes, np.ravel(found[of + "center"]), bend)

    stiffening = found.get("body_stiffening")
    return ReducedConstants(
        mass=float(np.ravel(found["body_mass"])[0]),
        S=np.reshape(found["body_S"], (d, m + 1)),
        T=np.ascontiguousarray(np.reshape(found["body_T"], (m + 1, m + 1, d, d))),
        K=np.reshape(found["body_K"], (m, m)),
        D=np.reshape(found["body_D"], (m, m)),
        surfaces=surfaces,
        center=np.ravel(found["body_center"]),
        size=float(np.ravel(found["body_size"])[0]),
        stiffening=None if stiffening is None else np.reshape(stiffening, (d + d * d, m, m)),
    )
