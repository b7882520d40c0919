"""What follows from a definition: row, rate, second derivative and tangent, as expressions, as C and as NumPy functions.

With twists V = (v_A, w_A, v_B, w_B) and a coordinate s(A, B, drive(t)):

    row      r_i = d(ds/dt)/dV_i                                                                              (1)
    rate     ds/dt - r . V         (from the drive; of a flow: its speed at rest)                             (2)
    gamma    d2s/dt2 at constant twists                                                                       (3)
    tangent  H_ij = d r_i / d(displacement j), made symmetric: the geometric stiffness of a unit effort       (4)

Each kind has three kernels over many items: ``value`` writes s, or (2) of a flow, and the entries of its row that are not zero
everywhere, ``rates`` writes (2) and (3), ``tangent`` writes the entries of the lower half of (4) times a weight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from itertools import accumulate
from typing import Any, ClassVar

import numpy as np

from ...rotations import Array
from .definitions import COORDINATES, FLOWS, IN_SPACE, Definition
from .expressions import ZERO, Expression, Program, c_lines, gradient, rebuilt, symbol, symbols_of
from .frames import FRAME, PLACES, AskedConstants, SymbolicFrame, symbolic_frames, twist_gradient, twist_of

KERNELS = ("value", "rates", "tangent")
WEIGHT = symbol("weight")
DRIVE = symbol("P_drive_0")
DRIVE_RATE = symbol("P_drive1_0")
DRIVE_RATE_2 = symbol("P_drive2_0")


@dataclass(frozen=True, eq=False)
class Kind:
    """One definition in a space of ``dim`` dimensions, derived.

    ``constants``: name -> size of the constants of an item, in the order of its table. ``entries``: which twist components
    (of A, then of B) the row has; ``pattern``: pairs of components of the tangent's lower half. ``outputs``: the expressions of
    each kernel, in terms of ``given``: symbols with their values, to be computed first.
    """

    name: str
    dim: int
    constants: dict[str, int]
    entries: tuple[int, ...]
    pattern: tuple[tuple[int, int], ...]
    outputs: dict[str, list[Expression]]
    given: list[tuple[Expression, Expression]]
    frames: tuple[SymbolicFrame, ...]
    flow: bool = False  # a speed, which is no rate of a coordinate
    sides: Mapping[str, int] = field(default_factory=dict)  # of constants that are fixed in A (0) or B (1)
    asked: ClassVar[bool] = False  # whether its kernels are told by Python

    @cached_property
    def width(self) -> int:
        """Numbers in the table of constants, an item."""
        return sum(self.constants.values())

    @property
    def driven(self) -> bool:
        """Whether a motion of time is among its constants: ``drive`` and its first and second rate."""
        return "drive" in self.constants

    def place(self, name: str) -> slice:
        """Columns of a constant in the table."""
        return self._places[name]

    @cached_property
    def _places(self) -> dict[str, slice]:
        ends = accumulate(self.constants.values())
        return {name: slice(end - size, end) for (name, size), end in zip(self.constants.items(), ends, strict=True)}

    def run(self, which: str, A: Array, B: Array, P: Array, W: Any = 1.0) -> Array:
        """One kernel in Python: frames, constants and a weight of items, a row of each array; results likewise."""
        made: Array = numpy_kernel(self, which)(A, B, P, W)
        return made

    def address(self, which: str) -> int:
        """Where compiled code finds a kernel that is told by Python; 0 for kinds that are compiled."""
        return 0

    @cached_property
    def between_origins(self) -> Kind:
        """The same between the origins of both frames, with the same table of constants: what arms add is not computed."""
        at = {symbol(f"P_{name}_{i}"): ZERO for name in PLACES for i in range(self.constants.get(name, 0))}
        arms = rebuilt([value for _, value in self.given], symbols=at)
        given = [(arm, value) for (arm, _), value in zip(self.given, arms, strict=True)]
        at |= {arm: ZERO for arm, value in given if value is ZERO}
        found = {which: rebuilt(outputs, symbols=at) for which, outputs in self.outputs.items()}

        y, *row = found["value"]
        tangent = found["tangent"]
        outputs = {
            "value": [y, *(r for r in row if r is not ZERO)],
            "rates": found["rates"],
            "tangent": [h for h in tangent if h is not ZERO],
        }
        return replace(
            self,
            entries=tuple(i for i, r in zip(self.entries, row, strict=True) if r is not ZERO),
            pattern=tuple(pair for pair, h in zip(self.pattern, tangent, strict=True) if h is not ZERO),
            outputs=outputs,
            given=[(arm, value) for arm, value in given if value is not ZERO],
        )

    def symbols(self) -> list[str]:
        """Names of all constants, component by component."""
        return [f"P_{name}_{i}" for name, size in self.constants.items() for i in range(size)]


def derive(
    name: str, dim: int, definition: Definition, *, flow: bool = False, between: int = 2, tangent: bool = True
) -> Kind:
    """Rows, rates and tangent of a definition ``between`` so many frames; ``flow``: it gives a speed, linear in the twists or
    beside a given speed, and no coordinate; ``tangent``: whether it has one.
    """
    frames = symbolic_frames(between, dim)
    constants = AskedConstants(dim)
    # flows are linear in the twist already, but for what they give to bodies at rest; others get their row by (1)
    seen: Any = (*frames, constants)
    y = definition(*seen)
    sizes = dict(constants.sizes)
    if "drive" in sizes:
        sizes |= {"drive1": 1, "drive2": 1}
    twist = twist_of(frames)

    row = gradient(y, twist) if flow else twist_gradient(y, frames)
    moving = ZERO if flow else gradient(y, [DRIVE])[0]
    partial = rebuilt([y], symbols=dict.fromkeys(twist, ZERO))[0] if flow else moving * DRIVE_RATE
    speed = partial
    for r, u in zip(row, twist, strict=True):
        speed = speed + r * u

    # the second derivative at constant twists: (1) once more along the motion, and the drive's own rates
    second = gradient(speed, [DRIVE])[0] * DRIVE_RATE + moving * DRIVE_RATE_2
    for slope, u in zip(twist_gradient(speed, frames), twist, strict=True):
        second = second + slope * u

    lower = _lower_half([twist_gradient(r, frames) for r in row]) if tangent else {}
    # what is zero in the formula is not computed
    entries = tuple(i for i, r in enumerate(row) if r is not ZERO)
    outputs = {
        "value": [partial if flow else y, *(row[i] for i in entries)],
        "rates": [partial, second],
        "tangent": [WEIGHT * h for h in lower.values()],
    }
    given = [(u, value) for f in frames for us, values in f.arms for u, value in zip(us, values, strict=True)]
    return Kind(name, dim, sizes, entries, tuple(lower), outputs, given, frames, flow, constants.sides(frames))


def _lower_half(H: list[list[Expression]]) -> dict[tuple[int, int], Expression]:
    """Entries of the lower half of the symmetric part that are not zero."""
    out = {}
    for i in range(len(H)):
        for j in range(i + 1):
            # symmetric but for how it was derived: one node where both agree
            mean = H[i][i] if i == j else (H[i][j] + H[j][i]) * 0.5
            if H[i][j] is H[j][i]:
                mean = H[i][j]
            if mean is not ZERO:
                out[i, j] = mean
    return out


@lru_cache
def kinds(dim: int) -> dict[str, Kind]:
    """The package's own kinds in the plane or in space."""
    found = {name: derive(name, dim, f) for name, f in COORDINATES.items()}
    found |= {name: derive(name, dim, f, flow=True) for name, f in FLOWS.items()}
    more = IN_SPACE if dim == 3 else ()
    return found | {f.__name__: derive(f.__name__, dim, f, flow=flow) for f, flow in more}


# ---- C ------------------------------------------------------------------------------------------------------------------------

SIGNATURE = "long n, const int *pair, const double *frames, const double *P, const double *W, double *restrict out"


def c_kernel(kind: Kind, which: str) -> str:
    """One kernel as a C function; ``W``: a weight for each item of a tangent."""
    results = kind.outputs[which]
    needed = _needed(kind, results)
    used = {x.arguments[0] for x in symbols_of([*results, *(y for _, y in needed)])}
    size = FRAME[kind.dim]

    lines = [f"void {kind.name}_{which}({SIGNATURE})", "{", "    (void)P; (void)W;"]
    lines.append(
        f"    for (long i_ = 0; i_ < n; i_++, pair += {len(kind.frames)}, P += {kind.width}, out += {len(results)}) {{"
    )
    placed = ", ".join(f"*{frame.name} = frames + {size} * pair[{k}]" for k, frame in enumerate(kind.frames))
    lines.append(f"        const double {placed}; " + " ".join(f"(void){frame.name};" for frame in kind.frames))
    lines += [f"        const double {name} = P[{i}];" for i, name in enumerate(kind.symbols()) if name in used]
    if "weight" in used:
        lines.append("        const double weight = W[i_];")

    arms = c_lines([y for _, y in needed], [f"const double {u.arguments[0]}" for u, _ in needed])
    lines += ["        " + line for line in _renamed(arms, "a")]
    lines += ["        " + line for line in c_lines(results, [f"out[{i}]" for i in range(len(results))])]
    return "\n".join([*lines, "    }", "}", ""])


def _needed(kind: Kind, results: list[Expression]) -> list[tuple[Expression, Expression]]:
    """The directions that some results use, with their values."""
    used = symbols_of(results)
    return [(u, value) for u, value in kind.given if u in used]


def _renamed(lines: list[str], letter: str) -> list[str]:
    """Temporary names with another first letter, so that two blocks of statements can follow one another."""
    import re

    return [re.sub(r"\bt(\d+)\b", letter + r"\1", line) for line in lines]


def c_source(found: dict[str, Kind]) -> str:
    """All kernels of some kinds as one translation unit."""
    parts = ["#include <math.h>", NEAREST]
    for kind in found.values():
        parts += [c_kernel(kind, which) for which in KERNELS]
    return "\n".join([*parts, ""])


NEAREST = """
/* angle plus the whole turns that bring it next to near */
static inline double nearest_turn(double angle, double near)
{
    const double turn = 6.283185307179586476925;
    return angle + turn * rint((near - angle) / turn);
}
"""


# ---- NumPy --------------------------------------------------------------------------------------------------------------------


@cache
def numpy_kernel(kind: Kind, which: str) -> Any:
    """A kernel for NumPy: f(A, B, P, W) with one item a row of each array (W: one number an item), results likewise."""
    results = kind.outputs[which]
    needed = _needed(kind, results)
    first = Program([y for _, y in needed])
    second = Program(results)
    size = FRAME[kind.dim]

    def function(A: Array, B: Array, P: Array, W: Any = 1.0) -> Array:
        values: dict[str, Any] = {f"A[{i}]": A[..., i] for i in range(size)}
        values |= {f"B[{i}]": B[..., i] for i in range(size)}
        values |= {name: P[..., i] for i, name in enumerate(kind.symbols())} | {"weight": W}
        values |= {u.arguments[0]: x for (u, _), x in zip(needed, first(values), strict=True)}

        columns = second(values)
        shape = np.broadcast_shapes(A.shape[:-1], B.shape[:-1], P.shape[:-1])
        return np.stack([np.broadcast_to(y, shape) for y in columns], axis=-1) if columns else np.zeros((*shape, 0))

    return function
