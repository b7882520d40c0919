"""What every body says of itself, whatever its kind: each kind overrides where it differs."""

from __future__ import annotations

from typing import Any, ClassVar


class Body:
    """The members that all bodies share.

    Attributes:
        name: what messages and sensors call it. ``dim``: 2 or 3, None: it fits scenes of any dimension.
        nodal: its unknowns are values at the nodes of a mesh, spread over the ranks.
        meshed: it has a mesh, whose surfaces can touch and whose displacements can be drawn.
        framed: it moves with one frame of its own.
        modal: it has amplitudes of modes as unknowns, computed from a mesh.
        by_surface: joints and forces take hold of its named surfaces, not of the body.
        locked: it stays where it is and has no unknowns.
        alone: nobody expects anything attached to it.
    """

    name: str
    dim: int | None
    nodal: ClassVar[bool] = False
    meshed: ClassVar[bool] = False
    framed: ClassVar[bool] = True
    modal: ClassVar[bool] = False
    by_surface: ClassVar[bool] = True
    alone: ClassVar[bool] = False
    locked: bool = False

    @property
    def elastic_law(self) -> Any:
        """Its elastic law: a bilinear form or an energy, None where it has none."""
        return None

    @property
    def may_do_work(self) -> bool:
        """Whether it may put energy into a scene: by loads, or by equations of a user's own."""
        return False

    @property
    def keeps_energy(self) -> bool:
        """Whether its own forces keep the sum of the recorded energies: no damping, no loads, nothing that is not recorded."""
        return not self.may_do_work
