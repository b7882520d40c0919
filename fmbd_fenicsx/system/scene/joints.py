"""The joints of a scene as batches of constraint rows: part of building a :class:`~fmbd_fenicsx.system.system.System`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ...errors import InputError, near
from ...mechanics.frames import Markers
from ...mechanics.joints.constraints import Batch, PlacedRow
from ...mechanics.joints.counted import CountedAngles, turning_freely
from ...mechanics.joints.couplings import CouplingBatch
from ...mechanics.joints.drives import Coupling, JointCoordinate, relative_of
from ...mechanics.joints.expressed import asked_rows, is_asked
from ...mechanics.joints.joints import Joint
from ...mechanics.joints.relative import RelativeAngle, RelativeCoordinates
from ...mechanics.kinds.derivation import Kind
from ...rotations import Array, Motions
from ..layout import RowBlock


@dataclass
class JointRows:
    """Collects the rows of joints; ``length`` tells that of the model, m, where a joint asks for it."""

    motions: Motions
    length: Callable[[], float]
    row: int = 0
    blocks: list[RowBlock] = field(default_factory=list)
    markers: dict[str, tuple[int, int]] = field(default_factory=dict)
    _kinds: dict[tuple[type[Batch], Kind | None], tuple[list[PlacedRow], list[int]]] = field(default_factory=dict)
    _couplings: list[tuple[Coupling, int]] = field(default_factory=list)

    def add(self, joint: Joint, markers: tuple[int, int], narrow: float = 0.0) -> None:
        """Append the rows of one joint with its markers; ``narrow``: see :class:`.RowBlock`."""
        if isinstance(joint, Coupling):
            markers = self.markers.get(joint.terms[0][0].joint.name, markers)
        self.markers[joint.name] = markers

        first, (a, b) = self.row, markers

        # rows of one kind are evaluated together, wherever they stand
        for r in asked_rows(joint, self.motions, self.length) if is_asked(joint) else joint.rows:
            pairs, rows = self._kinds.setdefault((r.kind, r.own), ([], []))
            pairs.append(PlacedRow(r, a, b, joint.length))
            rows.append(self.row)
            self.row += 1
        if isinstance(joint, Coupling):
            self._couplings.append((joint, self.row))
            self.row += 1

        self.blocks.append(RowBlock(joint.name, slice(first, self.row), joint.kind, a, b, narrow))

    def take(self, name: str, count: int, kind: str) -> slice:
        """Number so many rows of something else that is not a joint."""
        rows = slice(self.row, self.row + count)
        self.blocks.append(RowBlock(name, rows, kind))
        self.row += count
        return rows

    def batches(self) -> list[tuple[Batch, np.ndarray]]:
        """All batches with the numbers of their rows."""
        out: list[tuple[Batch, np.ndarray]] = [
            (kind(self.motions, p), np.array(r)) for (kind, _), (p, r) in self._kinds.items()
        ]
        if self._couplings:
            out.append((self._coupling_batch(), np.array([row for _, row in self._couplings])))
        return out

    def _coupling_batch(self) -> CouplingBatch:
        found: dict[type[RelativeCoordinates], list[tuple[JointCoordinate, int, float]]] = {}

        # coordinates of one kind are evaluated together
        for i, (joint, _) in enumerate(self._couplings):
            for s, c in joint.terms:
                if s.joint.name not in self.markers:
                    raise InputError(
                        f'Joint "{joint.name}" uses a coordinate of joint "{s.joint.name}", which is not in the scene before it. '
                        + near(s.joint.name, self.markers)
                    )

                found.setdefault(s.kind, []).append((s, i, c))

        terms = []
        for kind, entries in found.items():
            relative = relative_of(self.motions, kind, [(s, *self.markers[s.joint.name]) for s, _, _ in entries])
            terms.append(
                (relative, np.array([i for _, i, _ in entries]), np.array([c for *_, c in entries], dtype=float))
            )
        return CouplingBatch(terms, [joint.motion for joint, _ in self._couplings])


def counted_angles(
    m: Motions, markers: Markers, angles: Mapping[tuple[int, int], JointCoordinate], poses: Array
) -> CountedAngles:
    """The counted angles of a scene from those in use by their markers; ``poses`` at the start: all frames, the ground last."""
    ground = len(poses) - 1
    free = turning_freely(markers, ground)
    kept = [(s, a, b) for (a, b), s in angles.items() if m.dim == 3 or free[a] or free[b]]
    turn = relative_of(m, RelativeAngle, kept)
    assert isinstance(turn, RelativeAngle)
    start = poses[markers.frame, 2] if m.dim == 2 else np.zeros(len(markers.frame))
    return CountedAngles(markers, turn, start, free[turn.a] | free[turn.b])
