"""Forces of a field without inertia and weight, in the tables (``driver/fields/forms.c``): elasticity, damping, loads."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import numpy as np

from .....fem.factors.factor import address_of_solve
from .....fem.integrals import Integral, tabulated
from .....rotations import Array
from ..resting import RestingField
from ..structures import array_of, structure
from .field_matrices import NodeBlocks, node_matrix

if TYPE_CHECKING:
    from ..layout import TableLayout

Formed = list[tuple[Any, list[Integral]]]  # integrals, and the load (None: elasticity and damping) that they belong to


class FieldForces:
    """Those of the field of a part, number k of the system; what C only reads is shared by all tables of the system."""

    def __init__(self, tables: TableLayout, part: Any, k: int) -> None:
        self.part, self.store, self.dim = part, tables.store, tables.dim
        self._cache, self._key = tables.system.cache, k
        self.loads: list[Array] = []  # in world axes, in those of the frame, internal ones: (n d,) each
        # loads on the deformed body, and those whose stress stiffens it, with what multiplies their forms
        self.factors: list[tuple[Any, Array]] = []
        self.stressing: list[tuple[Any, Array]] = []

    def members(self) -> dict[str, int | float]:
        """Those of the structure Field."""
        field, part = self.part.field, self.part
        made: dict[str, int | float] = {"alpha": field.forms.mass_damping, "beta": field.forms.stiffness_damping}
        formed = formed_forces(self._cache, self._key, part)
        if not told_in_c(self._cache, self._key, part):
            return made
        if field.loads.loads:
            for name in ("dead", "following", "internal", "carried"):
                array, made[name] = self.store.array(np.zeros(part.n))
                self.loads.append(array)
            made["loaded_at"] = np.nan
        if field.D is not None and field.viscous.law is None:
            drag = NodeBlocks(field.D, self.dim)
            self.store.kept.append(drag)
            made["drag"] = self.store.structure(node_matrix(drag, self.dim))

        return made | self._listed("integrals", "integral", formed or []) | self._of_stress()

    def _of_stress(self) -> dict[str, int | float]:
        """Loads whose stress stiffens the body."""
        stiffening, store = self.part.stiffening, self.store
        if stiffening is None or not stiffening.loads:
            return {}
        loads = [load for load, _ in stiffening.loads]
        factors, at = store.array(np.zeros(len(loads)))
        self.stressing = [(load, factors[i : i + 1]) for i, load in enumerate(loads)]
        turning = [0 if A is None else store.structure(node_matrix(A, self.dim)) for A in map(self._turning, loads)]
        return {
            "stressing": len(loads), "load_factor": at, "load_turns": store.integers([x.follower for x in loads]),
            "turning": store.array(turning, np.uint64)[1],
        }  # fmt: skip

    def _turning(self, load: Any) -> NodeBlocks | None:
        """What displacements add to the nodal forces of a load that is carried along; None of others."""
        found = [A for one, A in self.part.stiffening.turned.matrices if one is load]
        if not found:
            return None
        blocks = NodeBlocks(found[0], self.dim)
        self.store.kept.append(blocks)
        return blocks

    def of_pressure(self) -> dict[str, int]:
        """Members of the structure Pressure: those of its balance, of a body that is not linear."""
        return self._listed("integrals", "integral", formed_balance(self._cache, self._key, self.part) or [])

    def of_steps(self) -> dict[str, int]:
        """Members of the structure Field: forces over steps that keep energy, compiled when they are first asked for."""
        if not told_in_c(self._cache, self._key, self.part):
            return {}
        return self._listed("means", "mean", formed_means(self._cache, self._key, self.part) or [])

    def _listed(self, count: str, first: str, formed: Formed) -> dict[str, int]:
        """How many integrals there are, and where the first one is, by these names."""
        integrals = [self._integral(one, load) for load, many in formed for one in many]
        if not integrals:
            return {}
        made: Any = array_of(structure("Integral", self.dim), len(integrals))(*integrals)
        self.store.kept.append(made)
        return {count: len(integrals), first: ctypes.addressof(made)}

    def _integral(self, one: Integral, load: Any) -> Any:
        """The structure Integral."""
        store = self.store
        factor, at_factor = store.array([1.0])
        if load is not None:
            self.factors.append((load, factor))

        (count, nodes), corners, width = one.node.shape, one.corner.shape[1], one.coefficients.shape[1]
        made = structure("Integral", self.dim)(
            kernel=one.kernel, count=count, nodes=nodes, components=one.components, corners=corners, width=width,
            node=store.shared(one.node), corner=store.shared(one.corner), points=store.shared(one.points),
            facet=None if one.facet is None else store.integers(one.facet), constants=store.shared(one.constants),
            coefficients=store.shared(one.coefficients), factor=at_factor,
            room=store.address(np.zeros(width + nodes * one.components + 3 * corners)),
        )  # fmt: skip

        for i, (places, entries) in enumerate(one.moving):
            made.moving[i], made.place[i] = len(places), store.integers(places)
            made.from_[i] = store.shared(np.ascontiguousarray(entries))
        return made

    def load(self, t: float) -> None:
        """Loads at a time (s)."""
        loads, name = self.part.field.loads, self.part.field.name
        now = {id(load): load.factor(t, name) for load in loads.loads}
        for values in self.loads:
            values[:] = 0.0
        dead, following, internal, carried = self.loads
        for load, b in loads.fixed:
            into = internal if load.internal else following if load.follower else dead
            into += now[id(load)] * b.ravel()
            if load.carried:
                carried += now[id(load)] * b.ravel()
        for load, factor in self.factors:
            factor[0] = -now[id(load)]
        for load, factor in self.stressing:
            factor[0] = now[id(load)]


def formed_forces(cache: dict[Any, Any], k: int, part: Any) -> Formed | None:
    """Integrals of internal forces that are not linear, and of loads on the deformed body, of part k; None where C does not know
    them. ``cache``: of the system.
    """
    key = "integrals", k
    if key not in cache:
        cache[key] = _formed(part)
    return cache[key]  # type: ignore[no-any-return]


def _formed(part: Any) -> Formed | None:
    field = part.field
    if not field.nonlinear:
        return []
    if field.loads.moving and not isinstance(part, RestingField):
        return None
    law = field.viscous.law is not None
    forms = [(None, field.residual_form)] + ([(None, field.viscous.residual.form)] if law else [])
    forms += [(load, rows.form) for load, _, rows in field.loads.moving]
    return _known(forms, [field.argument, field.viscous.rate if law else None, field.pressure_argument])


def formed_balance(cache: dict[Any, Any], k: int, part: Any) -> Formed | None:
    """Integrals of the balance of the pressure of part k, likewise; none where it is linear."""
    key = "integrals of the pressure", k
    if key not in cache:
        field = part.field
        forms = [(None, field.balance_form)] if field.nonlinear else []
        cache[key] = _known(forms, [field.argument, None, field.pressure_argument])
    return cache[key]  # type: ignore[no-any-return]


def formed_means(cache: dict[Any, Any], k: int, part: Any) -> Formed | None:
    """Integrals of the forces of part k over steps that keep energy, likewise."""
    key = "integrals of means", k
    if key not in cache:
        means = part.mean_forces
        cache[key] = _known(means.parts(), [means.u0, means.rate, None, means.u1])
    return cache[key]  # type: ignore[no-any-return]


def _known(forms: list[tuple[Any, Any]], moving: list[Any]) -> Formed | None:
    """Integrals of forms with their loads, in which these functions move; None where C does not know one."""
    found = [(load, tabulated(form, moving)) for load, form in forms]
    known = [(load, made) for load, made in found if made is not None]
    return known if len(known) == len(found) else None


def told_in_c(cache: dict[Any, Any], k: int, part: Any) -> bool:
    """Whether the forces of the field of part k are in C; Python tells all others. ``cache``: of the system."""
    field = part.field
    if part.stiffening is not None and (field.loads.moving or field.nonlinear):
        return False
    if field.mixed and (address_of_solve() is None or formed_balance(cache, k, part) is None):
        return False
    return formed_forces(cache, k, part) is not None
