"""The same scene with other bodies: finer spaces and meshes, more modes. Scenes and bodies are never changed, but made again.

Joints, forces, sensors, ties and contacts refer to bodies by their surfaces. A scene with other bodies is found by
following these references through the dataclasses of the scene: what refers to a replaced body is made again with the new
one, everything else is shared. Functions are not looked into: a law that holds a body in its closure keeps the old one, and
the scene then says that this body is not part of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ...errors import InputError, MeshError
from ...mechanics.bodies.bodies import ElasticBody
from ...mechanics.reduction.craig_bampton import ReducedBody
from .scene import Scene

HIGHEST = 3  # degree of displacements


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
        if id(x) in self.swap:
            return self.swap[id(x)]
        if id(x) not in self.made:
            self.made[id(x)] = x, self._copy(x)
        return self.made[id(x)][1]

    def _copy(self, x: Any) -> Any:
        if isinstance(x, ElasticBody | ReducedBody) or isinstance(x, type):
            return x
        if type(x) in (list, tuple):
            items = [self.of(y) for y in x]
            return x if all(a is b for a, b in zip(x, items, strict=True)) else type(x)(items)
        if type(x) is dict:
            values = {k: self.of(y) for k, y in x.items()}
            return x if all(values[k] is y for k, y in x.items()) else values
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


def finer_space(scene: Scene) -> tuple[Scene, list[str]]:
    """The scene with every elastic body in a space that its error is measured against, and the names of bodies on a mesh that
    have none.

    The degree is raised by one; at the highest degree the mesh is made again with half the cell size.
    """
    found, without = {}, []
    for name, body in scene.bodies.items():
        try:
            better = _finer(body, higher=True)
        except (InputError, MeshError):
            without.append(name)
            continue
        if better is not None:
            found[name] = better
    return with_bodies(scene, found), without


def refined(scene: Scene) -> Scene:
    """The scene with better spaces: quadratic instead of linear displacements, or meshes of half the cell size, or, where a mesh
    cannot be made again, a higher degree.

    Raises:
        InputError: no body of the scene can be refined.
    """
    found = {}
    for name, body in scene.bodies.items():
        for higher in (getattr(_source(body), "degree", HIGHEST) == 1, True):
            try:
                better = _finer(body, higher=higher)
            except (InputError, MeshError):
                continue
            if better is not None:
                found[name] = better
            break
    if not found:
        raise InputError(
            f'Scene "{scene.name}": no mesh can be refined. Meshes made by a script with a cell size h (or cells, counts) can, '
            "and degrees below 3."
        )
    return with_bodies(scene, found)


def more_modes(scene: Scene) -> Scene:
    """The scene with twice the vibration modes in each reduced body.

    Raises:
        InputError: there is no reduced body.
    """
    found = {n: ReducedBody(b.source, _doubled(b.basis)) for n, b in scene.bodies.items() if isinstance(b, ReducedBody)}
    if not found:
        raise InputError(f'Scene "{scene.name}" has no reduced body.')
    return with_bodies(scene, found)


def _source(body: Any) -> Any:
    return body.source if isinstance(body, ReducedBody) else body


def _finer(body: Any, *, higher: bool) -> Any:
    """The body with a higher degree, or on a finer mesh; None where it has no mesh. Raises where that is not possible."""
    if isinstance(body, ReducedBody):
        return ReducedBody(_finer(body.source, higher=higher), body.basis)
    if not isinstance(body, ElasticBody):
        return None
    if higher and body.degree < HIGHEST:
        return body.with_(degree=body.degree + 1)
    return body.with_(mesh=body.mesh.refined())


def _doubled(basis: Any) -> Any:
    """A basis of twice the vibration modes, or of all up to twice the frequency."""
    if basis.count is not None:
        return dataclasses.replace(basis, count=max(2 * basis.count, 2))
    assert basis.frequency is not None
    return dataclasses.replace(basis, frequency=2 * basis.frequency)
