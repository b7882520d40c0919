"""The same scene with other bodies: finer spaces and meshes, more modes. Scenes and bodies are never changed, but made again.

Joints, forces, sensors, ties and contacts refer to bodies by their surfaces. A scene with other bodies is found by
following these references through the dataclasses of the scene: what refers to a replaced body is made again with the new
one, everything else is shared. Functions are not looked into: a law that holds a body in its closure keeps the old one, and
the scene then says that this body is not part of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import FunctionType
from typing import Any

import numpy as np

from ...errors import InputError, MeshError
from ...mechanics.body import Body
from ...mechanics.reduction.reduced import ReducedPart
from ..sensors.sensor import PartName, named_part
from ..system import System
from .scene import Scene

FEW = 300  # unknowns of a body up to which nearly all that a run costs does not depend on their number
PLAIN = {type(None), bool, int, float, str, np.ndarray, FunctionType}  # what refers to no body
SOLID_RATE = 4.0  # squares of the size of the elements, less at corners


def with_bodies(scene: Scene, bodies: Mapping[str, Any]) -> Scene:
    """The scene with some bodies, by name, in place of its own."""
    swap = {id(scene.bodies[name]): body for name, body in bodies.items()}
    return _Swap(swap).of(scene)  # type: ignore[no-any-return]


class _Swap:
    """Copies of what refers to replaced objects; ``made`` keeps originals alive, so that their ids stay theirs."""

    def __init__(self, swap: dict[int, Any]) -> None:
        self.swap = swap
        self.made: dict[int, tuple[Any, Any]] = {}

    def of(self, x: Any) -> Any:
        """x itself, or a copy in which replaced objects are the new ones."""
        if type(x) in PLAIN:
            return x
        if id(x) in self.swap:
            return self.swap[id(x)]
        if id(x) not in self.made:
            self.made[id(x)] = x, self._copy(x)
        return self.made[id(x)][1]

    def _copy(self, x: Any) -> Any:
        if isinstance(x, type) or (isinstance(x, Body) and x.meshed):  # these refer to no other body
            return x
        if type(x) in (list, tuple):
            items = [self.of(y) for y in x]
            return x if all(a is b for a, b in zip(x, items, strict=True)) else type(x)(items)
        if isinstance(x, dict):
            values = {k: self.of(y) for k, y in x.items()}
            return x if all(values[k] is y for k, y in x.items()) else type(x)(values)
        if isinstance(x, PartName):
            part = self.of(x.part)
            return x if part is x.part else named_part("part", part)
        if not dataclasses.is_dataclass(x):
            return x

        fields = {f.name: getattr(x, f.name) for f in dataclasses.fields(x)}
        new = {k: self.of(y) for k, y in fields.items()}
        if all(new[k] is y for k, y in fields.items()):
            return x
        made = object.__new__(type(x))  # values that depend on the old body are not taken over
        for name, value in new.items():
            object.__setattr__(made, name, value)
        return made


def meshed_bodies(scene: Scene) -> list[str]:
    """Names of the bodies that have an error in space."""
    return [name for name, body in scene.bodies.items() if body.interpolated]


def modal_bodies(scene: Scene) -> list[str]:
    """Names of the bodies that have an error by their modes."""
    return [name for name, body in scene.bodies.items() if body.has_refined_basis]


def finer_space(scene: Scene, *, higher: bool = True) -> tuple[Scene, list[str]]:
    """The scene with every elastic body in a space that its error is measured against, and the names of bodies on a mesh that
    have none.

    With ``higher`` the degree is raised by one where a body has a choice, and that is cheap (:func:`_degree_is_dear`); else, at
    the highest degree, and in rods, beams and lines, the elements are halved.
    """
    found, without = {}, []
    for name in meshed_bodies(scene):
        body = scene.bodies[name]
        finer = _finer(body, (False, True) if higher and _degree_is_dear(body) else (higher,))
        if finer is None:
            without.append(name)
        else:
            found[name] = finer
    return with_bodies(scene, found), without


def _finer(body: Body, ways: tuple[bool, ...]) -> Body | None:
    """The body with elements of higher degree, or smaller ones, the first of these ways that it has; None where it has none."""
    for higher in ways:
        try:
            return body.with_finer_space(higher=higher)
        except (InputError, MeshError):
            continue
    return None


def _degree_is_dear(body: Body) -> bool:
    """Whether elements of half the size cost less than those of a higher degree: the tangents of a nonlinear energy are taken at
    so many points of cubic ones that a run in space takes three times as long.
    """
    return body.displacement_degree != 1 and body.nonlinear


def refined(scene: Scene) -> Scene:
    """The scene with better spaces: quadratic instead of linear displacements, or meshes of half the cell size, or, where a mesh
    cannot be made again, a higher degree.

    Raises:
        InputError: no body of the scene can be refined.
    """
    found = {}
    for name in meshed_bodies(scene):
        body = scene.bodies[name]
        # linear displacements become quadratic; else finer meshes, else a higher degree
        finer = _finer(body, (body.displacement_degree == 1, True))
        if finer is not None:
            found[name] = finer

    if not found:
        raise InputError(
            f'Scene "{scene.name}": no mesh can be refined. Those of read_gmsh, read_cad and read_mesh can, and degrees below 3.'
        )
    return with_bodies(scene, found)


def refined_by_finer_space(scene: Scene) -> bool:
    """Whether the finer spaces of :func:`finer_space` are those of :func:`refined`: of slender bodies, linear displacements, and
    nonlinear energies.
    """
    bodies = [scene.bodies[name] for name in meshed_bodies(scene)]
    return all(body.displacement_degree == 1 or not body.meshed or _degree_is_dear(body) for body in bodies)


def cheap_levels(scene: Scene, few: int = FEW) -> int:
    """How often the bodies of a scene can be :func:`refined` with a ``few`` unknowns at most in each; collective.

    A mesh with n corners and displacements of degree p has about d p^d n unknowns, 2^d times as many after each halving.
    """
    return min((_cheap_levels(scene.bodies[name], few) for name in meshed_bodies(scene)), default=0)


def _cheap_levels(body: Body, few: int) -> int:
    """The same for one body; none for a slender one."""
    degree = body.displacement_degree
    if not body.meshed or degree is None:
        return 0
    mesh = body.solid.mesh
    linear, corners = degree == 1, mesh.dolfinx.topology.index_map(0).size_global
    room = few / (mesh.dim * max(degree, 2) ** mesh.dim * corners)
    return int(linear + np.log2(room) // mesh.dim) if room >= 1.0 else 0


def slender(scene: Scene) -> bool:
    """Whether all that has an error in space are beams, rods, lines or wires: no corners, and cheap to refine."""
    return not any(scene.bodies[name].meshed for name in meshed_bodies(scene))


def expected_rate(scene: Scene) -> float:
    """By what the error in space falls from one level of :func:`refined` to the next, as long as it was not seen."""
    if not slender(scene):
        return SOLID_RATE
    rates = [scene.bodies[name].space_rate for name in meshed_bodies(scene)]
    return min(rates, default=SOLID_RATE)


def expected_rates(scene: Scene) -> dict[str, float]:
    """The same of each sensor: strains at a place are of the order that the degree of the elements is."""
    rate = expected_rate(scene)
    degrees = {name: sensor.strain_degree for name, sensor in scene.sensors.items()}
    return {name: rate if degree is None else min(rate, 2.0**degree) for name, degree in degrees.items()}


def one_kind(*levels: Scene) -> bool:
    """Whether from the first to the last of these levels only elements were halved, and degrees stayed."""
    first, *others = levels
    names = meshed_bodies(first)
    return all(x.bodies[n].displacement_degree == first.bodies[n].displacement_degree for x in others for n in names)


def more_modes(scene: Scene, system: System) -> Scene:
    """The scene with each reduced body by its finer basis: static modes of the surfaces that its ``system`` uses, and more
    vibration modes. It is the basis that the error by the modes was measured against, so its modes are known already.

    Raises:
        InputError: no body is reduced.
    """
    modal = modal_bodies(scene)
    if not modal:
        raise InputError(f'Scene "{scene.name}" has no reduced body.')
    used = {part.name: part.surfaces for part in system.parts if isinstance(part, ReducedPart)}
    return with_bodies(scene, {name: scene.bodies[name].with_refined_basis(used[name]) for name in modal})
