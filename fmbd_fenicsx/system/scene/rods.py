"""The rods of a scene: their nodes as frames, their elements, their sections; part of building a system."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...mechanics.bodies.bodies import RigidBody, Surface
from ...mechanics.placements import RigidBlock
from ...mechanics.rods.elements import RodElements
from ...mechanics.rods.rods import Rod, node_name
from ...rotations import Array, Motions


@dataclass
class RodNodes:
    """Rods with the frames of their first nodes, in the order in which they were added."""

    rods: list[tuple[Rod, int]] = field(default_factory=list)
    elements: list[RodElements] = field(default_factory=list)

    def add(self, rod: Rod, first: int) -> dict[str, int]:
        """Take a rod whose nodes are the frames from ``first`` on; returns names of nodes -> frames."""
        self.rods.append((rod, first))
        self.elements.append(rod.elements_on(first))
        return {node_name(rod.name, i): first + i for i in range(len(rod.nodes))}

    def section(self, side: Surface) -> tuple[int, Array]:
        """Frame and pose at the start of a section."""
        first = next(first for rod, first in self.rods if rod is side.body)
        node = side.body.node_of(side.name)
        return first + node, side.body.poses[node]

    @property
    def mass(self) -> float:
        """Mass of all rods, kg."""
        return sum(float(rod.inertia[0].sum()) for rod, _ in self.rods)

    def rigid_block(self, motions: Motions, rigid: list[RigidBody], frame_of: dict[str, int]) -> RigidBlock | None:
        """Rigid bodies and the nodes of the rods, whose lumped mass moves as theirs; None without any."""
        if not rigid and not self.rods:
            return None
        frames = [frame_of[b.name] for b in rigid]
        masses = [float(b.mass) for b in rigid]
        inertias = [b.inertia_matrix for b in rigid]

        for rod, first in self.rods:
            mass, inertia = rod.inertia
            frames.extend(range(first, first + len(mass)))
            masses.extend(mass)
            inertias.extend(inertia)
        return RigidBlock(motions, np.array(frames), np.array(masses), np.array(inertias))
