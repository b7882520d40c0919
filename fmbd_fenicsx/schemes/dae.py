"""The forms of the equations of constrained motion, as arguments of a scheme, and their residuals in local coordinates.

    xi' = rate(xi, v - U mu),     v' = a - U tau,     M a + h + G^T lambda = 0,     U = W^-1 G^T                   (1)

with xi the local coordinates q = q_0 o exp(xi), W the mass matrix frozen over some steps, and constraints on the levels

    0: g = 0       1: G v + g_t = 0       2: G a + gamma = 0                                                       (2)

========================  =========  =====================================================================================
form                      levels     multipliers, what it guarantees
========================  =========  =====================================================================================
:class:`Index3`           0          lambda. Positions stay on the constraints; velocities and multipliers lose order.
:class:`Index2`           1          lambda. Velocities stay; positions drift linearly.
:class:`Index1`           2          lambda. Full order of everything; positions drift quadratically.
:class:`Baumgarte`        2          lambda, with g'' + 2 alpha g' + beta^2 g = 0: the drift is bounded, two numbers to choose.
:class:`GGL`              0, 1       lambda, mu (Gear, Gupta, Leimkuhler). No drift in positions and velocities.
:class:`Overdetermined`   0, 1, 2    lambda, mu, tau: all levels hold, mu and tau correct in mass-weighted least squares.
:class:`StateSpace`       0, 1, 2    The same, U frozen over the step: a step of the ODE in coordinates of the tangent space.
:class:`Projected`        of ``of``  After each step q, then v, are projected on (2) in the mass metric.
========================  =========  =====================================================================================

mu and tau vanish in the exact solution. The highest level goes with lambda, level 0 of several with mu, level 1 of three
with tau.

Sources: Gear, Gupta and Leimkuhler, doi:10.1016/0377-0427(85)90008-1; Baumgarte, doi:10.1016/0045-7825(72)90018-7;
Fuehrer and Leimkuhler, doi:10.1007/BF01385644 (overdetermined); Potra and Rheinboldt, doi:10.1080/08905459108905138
(tangent-space parametrisation); Eich, doi:10.1137/0730075 (projection); Hairer, Lubich and Roche, doi:10.1007/BFb0093947.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ..answers import answered_by
from ..checks import check_fields
from ..errors import require
from ..rotations import Array
from ..system.scene.contents import Contents


@dataclass(frozen=True)
class Form:
    """Which levels of the constraints hold. ``index`` is the differentiation index: it scales the components in error norms. A
    form with several levels counts as of index 2: what its rows tell, and no differential equation, is seen by multipliers alone.
    """

    levels: ClassVar[tuple[int, ...]] = (0,)
    index: ClassVar[int] = 3
    frozen: ClassVar[bool] = False  # normal directions U at the start of the step
    projected: ClassVar[bool] = False
    # whether its rows are those of its levels, as compiled code makes them: not where a form of a user's own has others
    by_levels: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        cls.by_levels = cls.rows is Form.rows and cls.lower is Form.lower

    @property
    def pulls(self) -> tuple[float, float]:
        """What rows of accelerations have of G v + g_t (1/s) and of g (1/s^2) beside G a + gamma."""
        return 0.0, 0.0

    @property
    def unit(self) -> str:
        """Of the first of its rows, as lengths."""
        return ("m", "m/s", "m/s^2")[self.levels[0]]

    @property
    def name(self) -> str:
        """Name in reports and tables."""
        return type(self).__name__

    def rows(self, ev: Any, a: Array) -> list[Array]:
        """The constraints of each level, (k, n_lam), of k configurations with accelerations a."""
        found = []
        for level in self.levels:
            if level == 2:
                found.append(self._acceleration(ev, a))
            else:
                found.append(ev.opening() if level else ev.constraint())
        return found

    def lower(self, balance: Array, ev: Any, a: Array) -> Array:
        """The balance of configurations (.., n_v), and the rows of all levels behind it; collective."""
        return np.concatenate((balance, *self.rows(ev, a)), axis=-1)

    def rows_scale(self, s: Any) -> Any:
        """What a motion exp(s t) multiplies g by in the first of the rows, for a frequency s (1/s)."""
        rate, place = self.pulls
        return s ** self.levels[0] + rate * s + place

    def _acceleration(self, ev: Any, a: Array) -> Array:
        rows, (rate, place) = ev.jacobian.times(a) + ev.gamma(), self.pulls
        return rows + rate * ev.opening() + place * ev.constraint() if rate or place else rows


def positions_refused(held: Contents, name: str, levels: tuple[int, ...]) -> str:
    """Why a scheme or form ``name`` that asks for g = 0 does not take joints that hold velocities only; "" where it does."""
    if not held.rolling or 0 not in levels:
        return ""
    joint, kind = held.rolling[0]
    return (
        f'Joint "{joint}" ({kind}) holds velocities only, and {name} asks for positions. Take '
        "scheme=fmbd.GeneralizedAlpha(), fmbd.EnergyMomentum(), or BDF and Radau with form=fmbd.Index2()."
    )


class OfForm:
    """A scheme that takes the constraints in any form, but for those on positions where there are none; stiffly accurate."""

    form: Form
    forgets: ClassVar[bool] = True
    weighs: ClassVar[bool] = True
    finds_memories: ClassVar[bool] = True

    @property
    def carries_pressure(self) -> bool:
        """Whether bodies may have a pressure that is an unknown, whose volumes are held as by index 3."""
        return 2 not in self.form.levels

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        return positions_refused(held, f"form={self.form.name}", self.form.levels)


@dataclass(frozen=True)
class Unconstrained(Form):
    """M a = f, what any form is of a system without constraints."""

    levels = ()
    index = 1


@dataclass(frozen=True)
class Index3(Form):
    """Constraints on positions, g(q, t) = 0, with M a = f - G^T lambda: index 3."""


@dataclass(frozen=True)
class Index2(Form):
    """Constraints on velocities, G v + g_t = 0, with M a = f - G^T lambda: index 2.

    Positions drift from the joints, slowly; :class:`GGL` holds both.
    """

    levels = (1,)
    index = 2


@dataclass(frozen=True)
class Index1(Form):
    """Constraints on accelerations, G a + gamma = 0, with M a = f - G^T lambda: index 1, an ordinary differential equation.

    Positions and velocities drift from the joints as time goes on: for short runs, or inside of :class:`Projected`;
    :class:`Baumgarte` pulls them back.
    """

    levels = (2,)
    index = 1


@dataclass(frozen=True)
class Baumgarte(Form):
    """g'' + 2 alpha g' + beta^2 g = 0, alpha and beta in 1/s; alpha = beta is critical damping of the drift."""

    alpha: float = 10.0
    beta: float = 10.0
    levels = (2,)
    index = 1

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            self.alpha > 0 and self.beta > 0 and bool(np.isfinite(self.alpha + self.beta)),
            f"Baumgarte(alpha={self.alpha}, beta={self.beta}): both must be positive (1/s), else errors do not decay.",
        )

    @property
    def name(self) -> str:
        """With its two parameters."""
        return f"Baumgarte({self.alpha:g}, {self.beta:g})"

    @property
    def pulls(self) -> tuple[float, float]:
        """2 alpha and beta^2."""
        return 2 * self.alpha, self.beta**2


@dataclass(frozen=True)
class GGL(Form):
    """Positions and velocities (Gear, Gupta, Leimkuhler), mass-weighted: xi' = v - M^-1 G^T mu."""

    levels = (0, 1)
    index = 2


@dataclass(frozen=True)
class Overdetermined(Form):
    """Constraints on positions, velocities and accelerations together, g = 0, G v + g_t = 0, G a + gamma = 0; what the scheme
    cannot meet exactly is corrected by least squares in the mass metric.
    """

    levels = (0, 1, 2)
    index = 2


@dataclass(frozen=True)
class StateSpace(Form):
    """The ODE in the tangent space of the constraints at the start of each step; the normal part follows from all levels."""

    levels = (0, 1, 2)
    index = 2  # with 1 a mechanism without freedom, all of whose places its drives give, took steps of any size
    frozen = True


@answered_by("of", "levels index pulls")
@dataclass(frozen=True)
class Projected(Form):
    """Another form, followed by a projection of q, then v, in the mass metric after each step."""

    of: Form = field(default_factory=Index1)
    projected = True

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            len(self.of.levels) == 1 and not self.of.projected,
            f"Projected({self.of.name}()): the form holds several levels by itself; project Index1 or Index2.",
        )

    @property
    def name(self) -> str:
        """With the form that is projected."""
        return f"Projected({self.of.name})"


@dataclass
class Points:
    """Instants in local coordinates: xi, xi', v, v' (k, n_v) and multipliers (k, n_mult), with efforts of ties behind them."""

    xi: Array
    rate: Array
    v: Array
    vd: Array
    mult: Array
