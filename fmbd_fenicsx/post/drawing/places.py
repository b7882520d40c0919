"""Where frames and markers are at each snapshot of a run: what all pieces of a drawing are placed by."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...rotations import Array
from ...run.result import Run
from ...system.layout import State


@dataclass(frozen=True, eq=False)
class Places:
    """Frames and markers at the instants that are drawn, in space, world axes.

    Attributes:
        run, states: the run and its instants.
        frames, axes: origins (instants, frames + 1, 3) and rotations (instants, frames + 1, 3, 3); the ground is the last.
        markers, turns: positions (instants, markers, 3), and rotations since the start (instants, markers, 3, 3).
        coordinates: of every part, part name -> (instants, n).
    """

    run: Run
    states: tuple[State, ...]
    frames: Array
    axes: Array
    markers: Array
    turns: Array
    coordinates: dict[str, Array] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of instants."""
        return len(self.states)

    def frame(self, body: Any) -> tuple[Array, Array]:
        """Origin (instants, 3) and axes (instants, 3, 3) of a rigid body's frame, or of one that is locked."""
        names = self.run.system.frame_names
        if body.name in names:
            k = names.index(body.name)
            return self.frames[:, k], self.axes[:, k]

        # a body locked to the ground has no frame: it stays where it began
        m = self.run.system.motions
        pose = body.start_pose()
        origin, R = np.zeros(3), np.eye(3)
        origin[: m.dim], R[: m.dim, : m.dim] = pose[: m.dim], m.matrix(pose)
        return np.tile(origin, (self.count, 1)), np.tile(R, (self.count, 1, 1))

    def joint(self, name: str) -> tuple[int, int]:
        """Numbers of the two markers of a joint."""
        block = self.run.system.block(name)
        return block.a, block.b

    def force(self, name: str) -> tuple[int, int]:
        """Numbers of the two markers of a force element (equal where it has one)."""
        for loads in self.run.system.forces:
            for force, a, b in zip(loads.forces, loads.a, loads.b, strict=True):
                if force.name == name:
                    return int(a), int(b)
        raise KeyError(name)


def places(run: Run, states: list[State]) -> Places:
    """Frames and markers of a run at some of its states; collective."""
    s = run.system
    d = s.motions.dim
    n, count = s.n_frames + 1, len(states)
    frames = np.zeros((count, n, 3))
    axes = np.tile(np.eye(3), (count, n, 1, 1))
    markers, turns = [], []

    for k, state in enumerate(states):
        ev = s.at(state.t, state.q)
        frames[k, :, :d] = ev.pose[:, :d]
        axes[k, :, :d, :d] = ev.rotation
        # everything is drawn in space: the plane is z = 0
        x = np.zeros((len(ev.kin.x), 3))
        R = np.tile(np.eye(3), (len(ev.kin.x), 1, 1))
        x[:, :d], R[:, :d, :d] = ev.kin.x, ev.kin.R
        markers.append(x)
        turns.append(R)

    local = {p.name: np.array([s.local_q(state.q, k) for state in states]) for k, p in enumerate(s.parts)}
    return Places(run, tuple(states), frames, axes, np.array(markers), np.array(turns), local)
