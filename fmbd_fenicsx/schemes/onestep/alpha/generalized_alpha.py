"""Generalized-alpha on a Lie group, index-3 form.

    q_n+1 = q_n o exp(h v_n + h^2 ((1/2 - beta) A_n + beta A_n+1))                                        (1)
    v_n+1 = v_n + h ((1 - gamma) A_n + gamma A_n+1)                                                       (2)
    (1 - alpha_m) A_n+1 + alpha_m A_n = (1 - alpha_f) a_n+1 + alpha_f a_n                                 (3)
    M a + h + G^T lambda = 0,   g = 0     at t_n+1                                                        (4)

A is the algorithmic acceleration; the alphas weight the *old* value. alpha_m = (2 rho - 1) / (rho + 1), alpha_f = rho / (rho
+ 1), gamma = 1/2 + alpha_f - alpha_m, beta = (gamma + 1/2)^2 / 4 with rho the spectral radius at infinite frequency. Newton
solves for increments of q with the balance (4) multiplied by s = beta h^2 (1 - alpha_f) / (1 - alpha_m): the matrix is M +
.. + s K and the multiplier s lambda, so its condition does not depend on h (Bottasso, Dopico and Trainelli,
doi:10.1007/s11044-007-9051-9).

The stabilised form, ``form=GGL()``, demands both levels: G v + g_t = 0 at t_n+1 goes with lambda, and (1) gains a correction
-M^-1 G^T mu that closes g = 0. Velocities are then exact on their level, the start needs A_0 only, and rho_inf = 1 stays stable.
One iteration costs a second solve with the same factor.

Sources: Chung and Hulbert, doi:10.1115/1.2900803; Bruels, Cardona and Arnold, doi:10.1016/j.mechmachtheory.2011.07.017;
Arnold and Bruels, doi:10.1007/s11044-007-9084-0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ....errors import require
from ....linear.condensation import StepSolver
from ....system.layout import State
from ....system.system import System
from ...dae import GGL, Form, Index3
from ...error_norm import check_controlled
from ...newton import Newton
from .alpha_step import Rule

if TYPE_CHECKING:
    from .alpha_stepper import AlphaStepper


@dataclass(frozen=True)
class GeneralizedAlpha:
    """Generalized-alpha: implicit, of second order, with damping of high frequencies by choice.

    ``rho_inf``: in [0, 1]; 0 damps high frequencies most, 1 does not. With Index3() it must be below 1: at 1 roundoff in the
    multipliers grows until the run fails (Cardona and Geradin, doi:10.1016/0045-7949(89)90050-9).

    ``form``: Index3() or GGL().

    ``rtol``, ``atol``: error control, see :class:`.Radau`: the scheme chooses its steps (:mod:`.variable_alpha`); with
    rtol = None it takes steps of a given size.

    ``compiled`` = False keeps to NumPy where a compiled step exists (see :mod:`.alpha_driver`).
    """

    rho_inf: float = 0.8
    form: Form = field(default_factory=Index3)
    rtol: float | None = None
    atol: float | None = None
    compiled: bool = True

    def __post_init__(self) -> None:
        check_controlled(self)
        require(
            isinstance(self.form, Index3 | GGL),
            f"GeneralizedAlpha takes form=Index3() or GGL(), found {self.form!r}. BDF and Radau take all forms.",
        )
        require(
            0.0 <= self.rho_inf < 1.0 or (self.rho_inf == 1.0 and isinstance(self.form, GGL)),
            f"rho_inf = {self.rho_inf} is not usable: it must lie in [0, 1). At 1 the index-3 multipliers are weakly unstable "
            "and grow until the run fails; 0.9 damps little. form=GGL() permits 1.",
        )

    order = 2
    looks_ahead = True  # :mod:`.look_ahead`
    carries_accelerations = True
    takes_given = True

    @property
    def forgets(self) -> bool:
        """Whether eight steps leave less than a hundredth of a vibration that they do not resolve."""
        return self.rho_inf < 0.5

    @property
    def carries_pressure(self) -> bool:
        """Whether bodies may have a pressure that is an unknown."""
        return isinstance(self.form, Index3)

    @property
    def turn_limit(self) -> float | None:
        """Angle (rad) by which constraints on positions may turn in a step: :mod:`~fmbd_fenicsx.run.judges.turning_rows`."""
        fixed = self.rtol is None and isinstance(self.form, Index3)
        return 0.7 * (1.0 - self.rho_inf) if fixed else None

    @property
    def name(self) -> str:
        """Name in reports."""
        stabilised = ", GGL" if isinstance(self.form, GGL) else ""
        controlled = f", rtol={self.rtol:g}" if self.rtol is not None else ""
        return f"generalized-alpha(rho_inf={self.rho_inf:g}{stabilised}{controlled})"

    @property
    def parameters(self) -> tuple[float, float, float, float]:
        """alpha_m, alpha_f, gamma, beta."""
        rho = self.rho_inf
        am = (2 * rho - 1) / (rho + 1)
        af = rho / (rho + 1)
        gamma = 0.5 + af - am
        return am, af, gamma, 0.25 * (gamma + 0.5) ** 2

    def rule(self, h: float) -> Rule:
        """The scheme for steps of size h (s)."""
        return Rule(h, *self.parameters)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Any:
        """Time stepper from a consistent state."""
        if self.rtol is not None:
            from .variable_alpha import VariableAlpha

            return VariableAlpha(self, system, solver, newton, state)

        return self.steps((self, system, solver, newton, state))

    def steps(self, given: Given, *, alone: bool = True) -> AlphaStepper:
        """Time stepper for constant steps. ``alone``: nobody else solves for the system between them, so that the tables of who
        evaluates it in compiled code may serve.
        """
        newton = given[3]
        made = self._compiled_stepper(given, alone) if self.compiled and newton.tangent is None else None
        if made is not None:
            return made

        from .alpha_stepper import AlphaStepper

        return AlphaStepper(*given)

    def _compiled_stepper(self, given: Given, alone: bool) -> AlphaStepper | None:
        """Steps in compiled code; None where NumPy has to make them."""
        _, system, solver, _, _ = given
        redundant = solver.core.redundant

        if system.fields:
            from .alpha_driver import drivable
            from .field_stepper import FieldStepper

            return None if drivable(system) is None else FieldStepper(given, None)

        from .alpha_driver import alpha_driver
        from .compiled_stepper import CompiledAlphaStepper

        driver = alpha_driver(system, redundant=redundant, alone=alone)
        return None if driver is None else CompiledAlphaStepper(given, driver)


Given = tuple[GeneralizedAlpha, System, StepSolver, Newton, State]
