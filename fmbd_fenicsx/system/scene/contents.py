"""What a scheme has to know of a scene before it is built: which things it holds that not every scheme takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...energies import MixedEnergy
from .scene import Scene


@dataclass(frozen=True)
class Contents:
    """Names of what a scheme may refuse, in the order of the scene.

    Attributes:
        bodies: those that can move.
        contacts: pairs that may touch, and joint limits.
        limits: of these, joint limits.
        bouncing: of these, those with inertia on the points that touch: only a law of impacts makes their rebound certain.
        massless: of these, those of elastic surfaces whose nodes carry no inertia: they take no impulse.
        rolling: joints that hold velocities and no positions, with their kind.
    """

    bodies: tuple[Any, ...]
    contacts: tuple[str, ...]
    limits: tuple[str, ...]
    bouncing: tuple[str, ...]
    massless: tuple[str, ...]
    rolling: tuple[tuple[str, str], ...]

    @property
    def nodal(self) -> tuple[Any, ...]:
        """Bodies with unknowns at the nodes of a mesh."""
        return tuple(b for b in self.bodies if b.nodal)

    @property
    def pressures(self) -> tuple[str, ...]:
        """Bodies with a pressure that is an unknown."""
        laws = [(b.name, b.elastic_law) for b in self.nodal]
        return tuple(name for name, law in laws if isinstance(law, MixedEnergy) and law.carried)


def contents_of(scene: Scene) -> Contents:
    """What a scene holds; nothing is computed."""
    scene.refuse_strangers()
    pairs = scene.contacts.values()
    limits = tuple(scene.limits)
    return Contents(
        bodies=tuple(b for b in scene.bodies.values() if not b.locked),
        contacts=(*scene.contacts, *limits),
        limits=limits,
        bouncing=(*(c.name for c in pairs if c.bounces), *limits),
        massless=tuple(c.name for c in pairs if c.massless),
        rolling=tuple((j.name, j.kind) for j in scene.joints.values() if any(row.kind.on_speeds for row in j.rows)),
    )
