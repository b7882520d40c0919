"""Energy-momentum scheme: difference quotients for bodies, springs and constraints; for stiff motion without losses.

    q_n+1 = q_n o cay(h w),   w = (v_n + v_n+1) / 2,     M (v_n+1 - v_n) / h + f_dg + G_dg^T lambda = 0,   g(q_n+1) = 0     (1)

cay is the Cayley map, so that R_n+1 - R_n = h (R_n + R_n+1) / 2 w~; displacements u of absolute bodies move by h w. All
markers are taken at the mean of their old and new positions and rotations with exact Jacobians (:mod:`.discrete_gradient`); then

    spring      N_dg = mean of N(s) from s_n to s_n+1, along rows whose product with h w is s_n+1 - s_n                     (2)
    constraint  h G_dg w = g_n+1 - g_n: mean rows, plus a correction along M w where g is not of second order               (3)
    body        torques in body axes R_mean^-1 (x x f),   R_mean = (R_n + R_n+1) / 2                                       (4)
    field       forces of :mod:`fmbd_fenicsx.fem.mean_forces`

do as much work as energies change, and the constraint forces none. Weight and dead loads are linear. Energy is conserved
for any step, also h omega >> 1, and so are linear and angular momentum: all joints are of second order, their correction
in (3) is zero. Dampers and viscous laws take exactly their work at the mean point; other forces act at the mean point. Second
order in q, v and lambda: accelerations and multipliers of a state are solved for at its end, those in (1) are means over the
step. No damping at high frequencies, so the multipliers of stiff systems oscillate.

Usual steps are one call of C (driver/onestep/mean.c): Newton's iteration with the matrix M + h D / 2 + h^2 K / 4 of the
middle, fields with the tangent of an earlier state, turned with the body; increments tell what it leaves out, as the turn of
bodies over a step (driver/onestep/secants.c). Where that does not serve, one iteration solves for the core, the ports
p = H^T u of the fields and lambda together. With the tangent J_f of a field,
its residual r_f, z = J_f^-1 r_f and W = H^T J_f^-1 H, and forces P(a, p, lambda) of joints and springs on the ports,

    [ dR_c  ]          [ R_c   ]
    [ 1 p + W dP ]  = -[ H^T z ],          du = -z - J_f^-1 H dP                                                           (5)
    [ dg    ]          [ g     ]

The small tangent is taken by differences.

Sources: Gonzalez, doi:10.1007/s003329900016 (discrete gradient), doi:10.1016/S0045-7825(98)00204-8 (constraints); Simo and Wong,
doi:10.1002/nme.1620310103 (rotations); Betsch, doi:10.1007/s11044-005-0103-8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ....energies import MixedEnergy, StoredEnergy
from ....linear.condensation import StepSolver
from ....linear.redundancy import least
from ....log import log
from ....mechanics.bodies.bodies import AbsoluteBody
from ....polynomials import lagrange
from ....rotations import Array
from ....system.compiled.march import HISTORY, H, March
from ....system.compiled.states.evaluation import DriverStates
from ....system.compiled.states.means import IterationEnds
from ....system.layout import State
from ....system.scene.contents import Contents
from ....system.serialisation import Memory, Remembering, plain, worker
from ....system.system import System
from ...consistent import accelerations, behind_a_jump
from ...newton import Newton
from ...tangent_account import TangentAccount
from .steps_in_parts import NEAR, NOTHING, ROUNDOFF, StepsInParts

WORTH = 8  # increments of a step that cost what new tangents do: their matrices, factors and columns
LONGEST = 3  # means that are kept


class PastMeans(Remembering):
    """Accelerations (n,) and multipliers (n_lam,), newest first, each at the middle of its step.

    A prediction is the polynomial through so many of them as would have told the newest best: all where the motion is smooth, one
    where vibrations are not resolved by the steps, whose polynomials grow; or bodies that move on rigidly, where that is nearer.
    """

    keeps: ClassVar = {"known": Memory.past, **dict.fromkeys(("through", "rigidly", "missed"), plain())}

    def __init__(self, t: float, a: Array, lam: Array, rigid: bool) -> None:
        """``rigid``: whether there are bodies that may move on rigidly; the first prediction is that."""
        self.known = [(t, a, lam)]
        self.through, self.rigidly = 1, rigid
        self.missed = np.inf if rigid else 0.0  # by which the newest was

    def predicted(self, t: float) -> tuple[Array, Array]:
        """Both at t (s) by the best polynomial."""
        times, a, lam = zip(*self.known[: self.through], strict=True)
        w = np.array(lagrange(times, t))
        return w @ np.array(a), w @ np.array(lam)

    def take(self, mean: tuple[float, Array, Array], size: Callable[[Array], Array], rigid: Array | None) -> None:
        """The means of one more step; errors of predictions are those of accelerations (k, n), of this ``size``. ``rigid``: those
        of bodies that move on rigidly, where they are known.
        """
        t, a, _ = mean
        times, earlier, _ = zip(*self.known, strict=True)
        w = np.zeros((len(times), len(times)))  # of polynomials through one, two .. of them
        for k in range(len(times)):
            w[k, : k + 1] = lagrange(times[: k + 1], t)
        found = w @ np.array(earlier)
        missed = size((found if rigid is None else np.concatenate((found, rigid[None]))) - a)

        self.through, self.missed = int(np.argmin(missed[: len(times)])) + 1, float(missed.min())
        self.rigidly = rigid is not None and bool(missed[-1] <= self.missed)
        self.known = [mean, *self.known][:LONGEST]


POOR = 0.1  # error of a prediction, of the size of accelerations, above which bodies that move on rigidly may be nearer
LARGE = 0.5  # rad that a body turns in a step: the Cayley map lags by 2 %


@dataclass(frozen=True)
class EnergyMomentum:
    """Second order; keeps energy, momentum and angular momentum for any step, also where the step does not resolve vibrations:

        q_n+1 = q_n o cay(h w),   w = (v_n + v_n+1) / 2,   M (v_n+1 - v_n) / h + f_dg + G_dg^T lambda = 0,   g(q_n+1) = 0

    with difference quotients f_dg of the energies and G_dg of the constraints, which do as much work as energies change. It damps
    nothing, so that multipliers of stiff systems oscillate. There is nothing to choose. Gonzalez, doi:10.1007/s003329900016.
    """

    order = 2
    name = "energy-momentum"
    free_steps = True  # any size may follow any other

    holds = (0,)

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        return next((reason for body in held.nodal if (reason := _refused(body))), "")

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> EnergyMomentumStepper:
        """The time stepper of a run, from a consistent state."""
        return EnergyMomentumStepper(system, solver, newton, state)


def _refused(body: Any) -> str:
    """Why the scheme does not take a body with unknowns of a mesh, "" where it does."""
    if not isinstance(body, AbsoluteBody):
        return (
            f'EnergyMomentum takes elastic fields in absolute coordinates only, and "{body.name}" is not one. Use an '
            "AbsoluteBody, a ReducedBody (energy not kept), or GeneralizedAlpha."
        )
    law = body.elastic_law
    if isinstance(law, MixedEnergy) or (body.nonlinear and not isinstance(law, StoredEnergy)):
        return f'Body "{body.name}": EnergyMomentum needs a StoredEnergy W(C), such as saint_venant_kirchhoff(...).'
    if body.stiffness_damping and body.nonlinear:
        return (
            f'Body "{body.name}": stiffness_damping does not go with EnergyMomentum and an energy: it would change the '
            "angular momentum of strained bodies. Use viscous=fmbd.materials.kelvin_voigt(...)."
        )
    return ""


class EnergyMomentumStepper(StepsInParts):
    """Advances a consistent state. The unknowns of a step: mean accelerations of the core, ports of fields in use, lambda."""

    maker = "MEANS"
    keeps: ClassVar = {
        "state": Memory.state,
        **dict.fromkeys(("_kept", "counters"), plain()),
        "past": worker,
        "account": worker,
    }
    counters: dict[str, float] = {}

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(system, solver, newton, state)
        self.past = PastMeans(state.t, state.a, state.lam, rigid=bool(system.fields))
        self._rigid: Array | None = None  # mean accelerations of bodies that move on rigidly, where these may be needed
        self.account = TangentAccount()
        self.counters = {}
        self._warned = False  # of large turns

    def remember(self, m: Memory) -> None:
        """As :meth:`Remembering.remember`."""
        super().remember(m)
        if m("in parts", self.fields is not None):
            self._use_fields()
            self.fields.remember(m.inside("fields"))

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """Go on with velocities on the constraints: what drives prescribe may jump, and the rule holds means only."""
        self.state = behind_a_jump(self.system, start(), self.solver)
        return True

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton's iteration fails."""
        if self._step_in_one_call(h):
            return self.state
        s, driver = self.state, self.solver.driver
        self._old = None
        self._means = means = None if driver is None else driver.means(s, h)
        ends = self._ends(h)
        guess = self._guess(h, ends)

        # in compiled code first, but for a step that was found in parts before
        tried = driver is not None and means is not None and not self.account.otherwise and self._in_one_call(h)
        if tried:
            assert driver is not None and means is not None
            found = means.step((s.t, s.q, s.v), h, guess, ends, old=self.account.wasted_by(0) >= WORTH)
            self.newton.iterations += len(found.sizes)
            self.solver.core.factorisations += driver.new_factors()
            if found.end is not None:
                self._note(found.sizes)
                self.account.take(len(found.sizes), renewed=found.renewed)
                self._kept = None
                return self._take(h, (found.a, found.lam), found.end)

            if self.system.fields:
                self.account.failed()
            elif np.isfinite(found.a).all():
                guess = found.a, found.lam
        self.account.pass_by()
        return self._take(h, *self._in_parts(h, guess, ends, differences=tried))

    def _in_one_call(self, h: float) -> bool:
        """Where no tangent of steps in parts serves better."""
        return self._kept is None or self._kept[0] != h

    def _tables_of_steps(self) -> DriverStates | None:
        """As above; the matrix of a step on fields is no other with their masses."""
        return None if self.system.fields else super()._tables_of_steps()

    def _room(self, states: DriverStates) -> int:
        s, most = states.tables.system, self.newton.max_iterations + NEAR
        step = states.library.driver_mean_room(states.address)
        return 12 + most + s.n_v + max(int(step), 2 * s.n_v + 3 * s.n_lam + states.tables.nu)

    def _prepare_room(self, room: Array, *, alone: bool) -> None:
        ends = IterationEnds(0.0, NOTHING, ROUNDOFF, self.newton.max_iterations + NEAR)
        room[:12] = ends.most, np.inf if alone or self._warned else LARGE, *ends.numbers

    def _own(self, *, factored: bool) -> Array:
        wide = self._twin.velocities
        return np.array([np.concatenate(((t, self.past.through), wide(a), lam)) for t, a, lam in self.past.known])

    def _take_march(self, march: March, made: int) -> None:
        self._count_increments(march.parameters, made)
        if self.solver.driver is not None:
            self.solver.core.factorisations += self.solver.driver.new_factors()
        self._kept = None

        # as :meth:`_own` has laid them out
        steps, end = 1 + int(march.parameters[HISTORY]), 2 + march.system.n_v
        kept = [march.ring.own(i).copy() for i in range(steps)]
        self.past.known = [(float(own[0]), self._twin.forces(own[2:end]), own[end:]) for own in kept]
        self.past.through = int(kept[0][1])

        newest = self.past.known[0][1]
        self._warn_of_turns(float(march.parameters[H]), newest, march.state(1).v)

    def _guess(self, h: float, ends: IterationEnds) -> tuple[Array, Array]:
        """Mean accelerations and multipliers of the next step; collective."""
        system, s, past = self.system, self.state, self.past
        a, lam = past.predicted(s.t + 0.5 * h)
        self._rigid = None
        if not (system.fields and past.missed > POOR * ends.size):
            return a, lam

        # fields as they would move on rigidly
        self._rigid = a.copy()
        fields: list[tuple[int, Any]] = list(system.fields)
        for k, part in fields:
            U, V = system.local_q(s.q, k), system.local_v(s.v, k)
            system.local_v(self._rigid, k)[:] = 2.0 / h**2 * (part.moved_rigidly(U, V, h) - U - h * V)
        return self._rigid if past.rigidly else a, lam

    def _take(self, h: float, means: tuple[Array, Array], end: tuple[Array, Array]) -> State:
        """The state at the end of the step, its accelerations and multipliers solved for."""
        (a, lam), (q, v), s = means, end, self.state
        self._warn_of_turns(h, a, s.v)
        self.state = accelerations(self.system, State(s.t + h, q, v, s.a, lam), self.solver)
        lam = least(self.solver, s.t + h, q, lam)
        self.past.take((s.t + 0.5 * h, a, lam), self.system.each_typical, self._rigid)
        return self.state

    def _warn_of_turns(self, h: float, a: Array, v: Array) -> None:
        """Say once that a body turns so far in a step that the Cayley map lags: by 2 atan(x / 2) in place of x = h |w|, rad."""
        if self._warned or not self.system.n_frames:
            return
        turns = h * self.system.turning(v[: self.n] + 0.5 * h * a[: self.n])
        fastest = int(turns.argmax())
        if (x := float(turns[fastest])) <= LARGE:
            return
        self._warned = True
        log.warning(
            't = %.6g s: "%s" turns by %.2g rad a step, of which energy-momentum leaves out %.1f %%. Take dt = %.2g s or less, '
            "or fmbd.GeneralizedAlpha()",
            self.state.t, self.system.frame_names[fastest], x, 100 * (1 - 2 * np.arctan(0.5 * x) / x), 0.9 * LARGE * h / x,
        )  # fmt: skip
