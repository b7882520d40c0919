"""Reduced bodies from elastic ones: which modes, and the constants of ``mechanics.reduction.reduced`` computed with them.

    rod.reduced(modes=20)                                    free-free modes (mean axes) or clamped ones (attached frame)
    rod.reduced(frequency=500.0)                             all modes up to 500 Hz
    rod.reduced(basis=CraigBampton(("pin", "tip"), 10))      static interface modes and 10 modes with fixed interfaces
    rod.reduced(basis=CraigBampton(("pin", "tip"), 10, inertia=True))    ... and the static sag under inertia forces

For a jointed body take CraigBampton with the surfaces that its joints hold: beside their static modes few others are enough.
A body with geometric stiffening keeps the static displacements under its inertia forces beside the modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...answers import answered_by
from ...checks import check_fields
from ...errors import require
from ...fem.fields import Field
from ...fem.mixed import make_field
from ...log import log
from ...matrices import orthonormalising
from ...rotations import Array
from ..elastic.floating import attachment, frame_conditions, moment_columns
from ..elastic.floating_start import framed_start
from ..elastic.stiffening import Stiffening
from .reduced import ModalBody, ReducedConstants, SurfaceData, constants_of

SMALL = 10_000  # unknowns of a field up to which its matrices and factors, some megabytes, are kept beside its modes
LEFT_OUT = 1e-4  # share of the mean square of an initial displacement above which modes that miss it are warned of
STRAINS_LEFT_OUT = 0.05  # share of the strain energy under an internal load that a basis may lack in silence


@dataclass(frozen=True)
class FrameModes:
    """Vibration modes in the body's own frame: free-free for mean axes, clamped on average for an attached frame.

    Either ``count`` modes, or all modes up to ``frequency`` (Hz).
    """

    count: int | None = None
    frequency: float | None = None

    def __post_init__(self) -> None:
        check_fields(self, "modes")
        require(
            (self.count is None) != (self.frequency is None), "Give either the number of modes or a frequency limit."
        )
        require(self.count is None or self.count >= 0, f"modes = {self.count} must not be negative.")
        require(self.frequency is None or self.frequency > 0, f"frequency = {self.frequency} Hz must be positive.")

    def columns(self, field: Field, frame: Array) -> Array:
        """Nodal fields that span the basis, (n d, m)."""
        return _select(field, frame, self)


@dataclass(frozen=True)
class CraigBampton:
    """Static modes of the moments of the ``interfaces`` (surfaces), and vibration modes with these moments at rest.

    ``inertia`` adds the static displacements under the inertia forces M (a + L X) of rigid motion, d + d^2, interfaces at rest:
    weight, slow inertia forces and those of a steady spin are then exact, and stresses converge fast.
    """

    interfaces: tuple[str, ...]
    count: int | None = None
    frequency: float | None = None
    inertia: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        require(len(self.interfaces) > 0, "CraigBampton needs at least one interface surface.")
        FrameModes(self.count, self.frequency)

    def columns(self, field: Field, frame: Array) -> Array:
        """Nodal fields that span the basis, (n d, m)."""
        from ..elastic.modes import ConditionedBody

        C = independent(field, [moment_columns(field, s) for s in self.interfaces])
        body = ConditionedBody(field, C)
        try:
            fixed = _vibrations(body, self)
            static = body.static_modes(np.stack(_inertia_patterns(field), axis=1) if self.inertia else None)
        finally:
            body.destroy()
        return np.concatenate((static, fixed), axis=1)


@dataclass(frozen=True)
class RefinedBasis:
    """A ``basis`` and much of what it leaves out: what the error of reduction of a run is measured against.

    It adds the static modes of the ``surfaces`` in use and, with these surfaces at rest, the static displacements under the
    inertia forces M (a + L X) of rigid motion and under the body's loads, and as many vibration modes as the basis has, at
    least eight.
    """

    basis: Any
    surfaces: tuple[str, ...]

    def columns(self, field: Field, frame: Array, given: Array | None = None) -> Array:
        """Nodal fields that span the basis, (n d, m); ``given``: those of the basis that it contains, where they are known."""
        from ..elastic.modes import ConditionedBody

        given = self.basis.columns(field, frame) if given is None else given
        C = frame
        if self.surfaces:
            C = independent(field, [moment_columns(field, s) for s in self.surfaces])
        room = field.n_global - C.shape[1]
        body = ConditionedBody(field, C)
        added = [given]
        if not self._static_are_given:
            forces = np.stack((*_inertia_patterns(field), *_load_patterns(field)), axis=1)
            added.append(body.static_modes(forces) if self.surfaces else body.solve_static(forces))
        added.append(body.vibration_modes(min(max(given.shape[1], 8), room))[1])
        body.destroy()
        return np.concatenate(added, axis=1)

    @property
    def _static_are_given(self) -> bool:
        """Whether the basis that it contains is refined itself, for the same surfaces: their static displacements are in it."""
        return isinstance(self.basis, RefinedBasis) and self.basis.surfaces == self.surfaces


def _inertia_patterns(field: Field) -> list[Array]:
    """Nodal forces (n d,) M e_i and M X_j e_i: the inertia forces of any rigid motion are their sums."""
    shapes = (np.ones(field.n), *field.X.T)
    return [field.mass(np.outer(s, e)).ravel() for s in shapes for e in np.eye(field.dim)]


def _load_patterns(field: Field) -> list[Array]:
    """Nodal forces (n d,) whose sums are the body's loads in its axes: a dead load turns in them, its components mix."""
    found: list[Array] = []
    for load, b in field.loads.fixed:
        axes = np.eye(field.dim)
        turned = [b] if load.follower else [np.outer(c, e) for c in b.T for e in axes]
        found += [x.ravel() for x in turned if field.total(np.array(np.abs(x).sum())) > 0]
    return found


def independent(field: Field, groups: Sequence[Array]) -> Array:
    """Orthonormal columns that span those of some surfaces, all of one unit: on a plane surface the moment along its normal is
    zero.
    """
    C = np.concatenate(groups, axis=1)
    return np.asarray(C @ orthonormalising(field.total(C.T @ C), 1e-12) * field.mass_total)


def _select(field: Field, conditions: Array, wanted: Any) -> Array:
    """Modes by number or by frequency."""
    from ..elastic.modes import ConditionedBody

    if wanted.count == 0:
        return np.zeros((field.n * field.dim, 0))
    body = ConditionedBody(field, conditions)
    try:
        return _vibrations(body, wanted)
    finally:
        body.destroy()


def _vibrations(body: Any, wanted: Any) -> Array:
    """The same, of a body whose conditions are factored."""
    if wanted.count is not None:
        return np.asarray(body.vibration_modes(wanted.count)[1])
    limit = 2 * np.pi * wanted.frequency
    n = 8
    room = body.field.n_global - body.C.shape[1]
    while True:
        omega, phi = body.vibration_modes(min(n, room))
        if omega[-1] > limit or n >= room:
            return np.asarray(phi[:, omega <= limit])
        n *= 2


@answered_by("source", "name dim displacement_degree elastic_law may_do_work keeps_energy start_twist")
@dataclass(frozen=True, eq=False)
class ReducedBody(ModalBody):
    """An elastic body by a few modes in its floating frame; made by ``FloatingBody.reduced``.

    The reduction is computed at first use and kept: later runs of the body start at once. ``source`` is the full body.
    ``coarser``: the same body with the basis that this one contains, where it was made of it.
    """

    meshed = modal = interpolated = True

    source: Any
    basis: FrameModes | CraigBampton | RefinedBasis
    coarser: ReducedBody | None = field(default=None, init=False, repr=False)

    @property
    def has_refined_basis(self) -> bool:
        """With more modes."""
        return True

    @property
    def solid(self) -> Any:
        """The full body."""
        return self.source

    def surface(self, name: str) -> Any:
        """The named surface of the mesh."""
        return replace(self.source.surface(name), body=self)

    @cached_property
    def reduction(self) -> Reduction:
        """Modes and constants; collective at first use."""
        return reduce_body(self.source, self.basis, None if self.coarser is None else self.coarser.reduction)

    @property
    def constants(self) -> ReducedConstants:  # type: ignore[override]
        """What the time loop needs."""
        return self.reduction.constants

    @cached_property
    def _finer(self) -> dict[tuple[str, ...], ReducedBody]:
        return {}

    def with_refined_basis(self, surfaces: tuple[str, ...]) -> ReducedBody:
        """The same body with the basis :class:`RefinedBasis`, made once for the surfaces in use."""
        if surfaces not in self._finer:
            made = ReducedBody(self.source, RefinedBasis(self.basis, surfaces))
            object.__setattr__(made, "coarser", self)
            self._finer[surfaces] = made
        return self._finer[surfaces]

    def with_finer_space(self, *, higher: bool) -> ReducedBody:
        """As many modes of the full body in a finer space; collective."""
        return ReducedBody(self.source.with_finer_space(higher=higher), self.basis)

    def start_local(self) -> tuple[Array, Array]:
        """Modal amplitudes and rates at the start."""
        return self.reduction.start

    def start_frame(self) -> tuple[Array, Array]:
        """Pose and twist of the frame at the start."""
        return self.reduction.frame


@dataclass(frozen=True, eq=False)
class Reduction:
    """Constants, and the modes phi (n d, m) on this rank's nodes of ``space``.

    ``start``: amplitudes (m,) of the initial displacement and of its rate; ``frame``: pose and twist of the frame with them;
    ``moments``: those of the surfaces. ``field``: with its factors, where these are small.
    """

    constants: ReducedConstants
    phi: Array
    space: Any
    start: tuple[Array, Array]
    frame: tuple[Array, Array]
    moments: dict[str, Any]
    field: Field | None = None

    @property
    def omega(self) -> Array:
        """Frequencies of the modes, rad/s."""
        return np.sqrt(np.diag(self.constants.K))


def _loads(f: Field, Z: Array) -> tuple[tuple[tuple[Any, Array], ...], dict[Any, Array]]:
    """Loads with sum_n b_n Z_a,n^T (m + 1, d, d), and their sums over the nodes (d,)."""
    tensors, sums = [], {}
    for load, b in f.loads.fixed:
        tensors.append((load, np.asarray(f.total(np.einsum("ni,nja->aij", b, Z)))))
        sums[load] = np.asarray(f.total(b.sum(0)))
    return tuple(tensors), sums


def reduce_body(
    body: Any, basis: FrameModes | CraigBampton | RefinedBasis, known: Reduction | None = None
) -> Reduction:
    """Modes and constants of an elastic body; collective. ``known``: the reduction by the basis that a refined one contains.

    Raises:
        InputError: more modes than unknowns.
    """
    from ..elastic.modes import orthonormal_modes

    f = known.field if known is not None and known.field is not None else make_field(body.name, body.mesh, body.forms())
    if f.kept_factors is None:
        f.kept_factors = {}  # all that follows solves with the same one
    if known is not None:
        f.known_moments.update(known.moments)

    frame = frame_conditions(f, body.frame)
    if isinstance(basis, RefinedBasis) and known is not None and not body.held_at:  # which adds columns of stress
        V = basis.columns(f, frame, known.phi)
    else:
        V = basis.columns(f, frame)

    stress = None
    if body.held_at and V.shape[1]:
        stress = Stiffening(f, attachment(f, body.held_at), [s for s in f.mesh.surface_names if s != body.held_at])
        V = np.concatenate((V, stress.columns), axis=1)  # the stretch of steady rotation is then exact

    K: Array = np.zeros((0, 0))
    phi: Array = np.zeros((f.n * f.dim, 0))
    if V.shape[1]:
        K, phi = orthonormal_modes(f, V, frame)
        _tell_strains_left_out(f, frame, K, phi)
    constants = _constants(body, f, K, phi, stress)

    start = framed_start(body, f, frame)
    local = _amplitudes(f, start.U, phi), _amplitudes(f, start.Ud, phi)
    # a refined basis finds small ones here
    kept = f.n_global <= SMALL and f.comm.size == 1 and not body.held_at
    if not kept:
        f.destroy()  # its space, on whose nodes modes live, outlives it
    return Reduction(constants, phi, f.space, local, (start.pose, start.twist), f.known_moments, f if kept else None)


def _constants(body: Any, f: Field, K: Array, phi: Array, stress: Stiffening | None) -> ReducedConstants:
    """What the time loop needs of the modes phi with stiffness K; ``stress``: that stiffens the body. Collective."""
    d, m = f.dim, phi.shape[1]
    Z = np.concatenate((f.X[:, :, None], phi.reshape(f.n, d, m)), axis=2)
    # the undeformed body and its modes are columns of one array
    MZ = f.mass_columns(Z)
    S, T = (f.total(x) for x in constants_of(Z, MZ))
    surfaces = {name: _surface(f, name, phi, stress, body.held_at) for name in f.mesh.surface_names}

    D = body.mass_damping * np.eye(m) + body.stiffness_damping * K
    if f.D is not None and m:
        D = D + f.total(phi.T @ np.stack([f.damping(a) for a in phi.T], axis=1))

    stiffening = None
    load_stress: dict[Any, Array] = {}
    load_turned: dict[Any, Array] = {}
    if stress is not None:
        stiffening = stress.modal(phi, stress.columns)
        for (load, _), columns in zip(stress.loads, stress.load_columns, strict=True):
            load_stress[load] = stress.modal(phi, columns).reshape(d, d, m, m)
        for load, more, frame in stress.turned.columns(phi):
            load_turned[load] = np.concatenate((frame, f.total(phi.T @ more)))
    return ReducedConstants(
        f.mass_total, S, T, K, D, surfaces, f.center, f.size, stiffening,
        *_loads(f, Z), load_stress, load_turned, f.numbers,
    )  # fmt: skip


def _surface(f: Field, name: str, phi: Array, stress: Stiffening | None, held_at: str | None) -> SurfaceData:
    """Ports of a surface by the modes, and how they bend under its forces; collective."""
    d, m = f.dim, phi.shape[1]
    mom = f.moments(name)
    by_mode = np.einsum("na,ndk->adk", mom.weights, phi.reshape(f.n, d, m)[mom.nodes])
    ports = f.total(by_mode.reshape((1 + d) * d, m))
    bend = stress.modal(phi, stress.section_columns[name]) if stress and name != held_at else None
    return SurfaceData(mom.reference, ports, mom.center, bend)


def _tell_strains_left_out(f: Field, frame: Array, K: Array, phi: Array) -> None:
    """A warning where the modes phi do not deform as internal loads at rest do; collective. The full body has the work b . u,
    its modes sum (phi_k . b)^2 / K_kk: surfaces may move as they should without the strains between them.
    """
    from ..elastic.modes import ConditionedBody

    given = [b.ravel() for load, b in f.loads.fixed if load.internal]
    if not given:
        return
    B, body = np.stack(given, axis=1), ConditionedBody(f, frame)
    whole = f.total((B * body.solve_static(B)).sum(axis=0))
    body.destroy()
    held = (f.total(phi.T @ B) ** 2 / np.diag(K)[:, None]).sum(axis=0)
    left = float(np.max(1.0 - held[whole > 0] / whole[whole > 0], initial=0.0))
    if left > STRAINS_LEFT_OUT:
        log.warning(
            'body "%s": its %d modes leave out %.2g of the strain energy of an internal load, and strains and stresses lack it. '
            "Record these of the full body",
            f.name,
            phi.shape[1],
            left,
        )


def _amplitudes(f: Field, U: Array, phi: Array) -> Array:
    """Amplitudes (m,) of the modes in nodal displacements U or their rate; a warning of what they leave out."""
    if not f.total(np.array(np.abs(U).sum())):
        return np.zeros(phi.shape[1])
    MU = f.mass(U.reshape(-1, f.dim)).ravel()
    eta = np.asarray(f.total(phi.T @ MU))
    whole = float(f.total(np.array(U @ MU)))
    left = 1.0 - float(eta @ eta) / whole if whole > 0 else 0.0
    if left > LEFT_OUT:
        log.warning(
            'body "%s": its %d modes leave out %.2g of the mean square of its initial displacement or rate',
            f.name,
            phi.shape[1],
            left,
        )
    return eta
