"""The structures of ``driver/tables.h``, field by field, and a store that keeps their arrays alive."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ....kernel_cache import address_of as address_of
from ....kernel_cache import addresses_of as addresses_of
from ....rotations import Array

_INT = ctypes.c_int
_REAL = ctypes.c_double
_LONG = ctypes.c_long
_POINTER = ctypes.c_void_p

PYTHON = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_double)


def _fields(text: str, kind: Any) -> list[tuple[str, Any]]:
    return [(name, kind) for name in text.split()]


Fields = Sequence[tuple[str, Any]]

ALIKE: dict[str, Fields] = {  # in the plane and in space
    "Batch": [
        *_fields("value rates tangent", _POINTER),
        *_fields("role outputs live products curved number flow driven linked quotient told", _INT),
        *_fields("n width", _LONG),
        *_fields(
            "pair P out entry at row factor dest stiffness damping free s rate effort weight slope foretold", _POINTER
        ),
        ("formula", _INT),
        *_fields("constants kept known", _POINTER),
        *_fields("first second product_to curve curve_to", _POINTER),
        ("hessians", _INT),
        ("hessian", _POINTER),
        ("near", _INT),
        ("theta", _POINTER),
        ("mapped", _INT),
        *_fields("component slot", _POINTER),
        *_fields("where lower row_start square_start row_to row_on square_to", _POINTER),
        *_fields("marker astray sight push K B", _POINTER),
    ],
    "Body": [
        *_fields("modes at_v at_q at_u", _INT),
        *_fields("mass large", _REAL),
        *_fields("inertia S T V modal K C stress U now bent mean heavy block dest field told", _POINTER),
    ],
    "Told": [*_fields("number rests", _INT), *_fields("state rows block dest", _POINTER)],
    "Field": [
        *_fields("n nodes", _LONG),
        *_fields("solved frames row sways number inertial turns", _INT),
        *_fields("X Q port port_start port_on M_start M_column K_start K_column M K", _POINTER),
        ("beta", _REAL),
        ("own", _INT),
        *_fields(
            "state sums inertia moment Y S A W G frame_slot p rates accel force MU b z MX began T pz rest f h", _POINTER
        ),
        *_fields("stresses bends", _INT),
        *_fields("stress_start stress_column stress N bent form bias pull held second one first", _POINTER),
        *_fields("direct factor rhs solution told", _POINTER),
        *_fields("of_mass of_stiffness lossy tolerance", _REAL),
        ("parts", _INT),
    ],
    "Front": [
        *_fields("pivots rows ld next", _INT),
        ("start", _LONG),
        *_fields("unknown to", _POINTER),
    ],
    "Rod": [
        *_fields("k points nodes number", _INT),
        ("n", _LONG),
        *_fields("node loaded", _POINTER),
        ("beta", _REAL),
        *_fields("N slope weight natural C z E strain rate S density load to", _POINTER),
    ],
    "Deflection": [*_fields("at_q at_v n", _INT), ("rms", _POINTER), *_fields("size reached", _REAL)],
    "Control": [
        *_fields("rtol atol length least way reached", _REAL),
        ("origin", _POINTER),
        *_fields("frames core deforming place ratio", _LONG),
        ("deflection", _POINTER),
        *_fields("high low", _REAL),
        ("count", _LONG),
        *_fields("stretch end calm floor turn until error before largest peak fading", _REAL),
        *_fields("e y a missed", _POINTER),
    ],
    "System": [
        *_fields("bodies surfaces batches fronts angles rods rows nu nv nq redundant fields core", _INT),
        *_fields("body surface batch front angle rod frames velocity residual", _POINTER),
        *_fields("gap motion gravity weight diagonal row_dest", _POINTER),
        ("storage", _LONG),
        *_fields("L inverse b local sign units row_units multiplier_units", _POINTER),
        ("python", PYTHON),
        *_fields("samples stiff", _INT),
        *_fields("cd ck epsilon share", _REAL),
        *_fields("q work big", _POINTER),
        *_fields("evaluations factors calls", _LONG),
        *_fields("remembers seen readings reactions", _INT),
        *_fields("seen_frame seen_angle", _POINTER),
        ("accelerated", _INT),
        *_fields("seen_place reaction motion_rate motion_second rest_gravity slip", _POINTER),
        ("settled", _REAL),
        *_fields("again renewed led renewable foretells renewals telling linkable links", _INT),
        *_fields("push pull answer mutual", _POINTER),
        *_fields("indefinite leaves_out", _INT),
        ("from", _POINTER),
        ("span", _REAL),
        ("timed", _INT),
        *_fields("timed_at timed_size", _POINTER),
        *_fields("parts imaginary", _INT),
        ("lossy", _POINTER),
    ],
}


def _by_dimension(dim: int) -> dict[str, Fields]:
    """Fields of the structures that hold vectors."""
    rotations = 2 * dim - 3

    return {
        "Surface": [
            *_fields("body sort", _INT),
            ("measure", _REAL),
            *_fields("reference ports now", _POINTER),
            ("bends", _INT),
            *_fields("N G", _POINTER),
            ("p", _REAL * dim),
            ("b", _REAL * (dim * (1 + dim))),
            ("Z", _REAL * rotations**2),
            ("turn", _REAL * dim**2),
            *_fields("lever arm", _REAL * dim),
            *_fields("map bend_map", _POINTER),
            ("bias", _REAL * (dim + rotations)),
        ],
        "Angle": [
            *_fields("a b", _INT),
            *_fields("ea fa ga eb fb gb", _REAL * dim),
            ("zero", _REAL),
            ("free", _INT),
        ],
        "Reaction": [*_fields("items frame", _INT), *_fields("batch item side", _POINTER), ("p", _REAL * dim)],
    }


@lru_cache
def structure(name: str, dim: int) -> type[ctypes.Structure]:
    """``Batch``, ``Surface``, ``Body``, ``Front``, ``Rod`` .. or ``System`` of the driver in ``dim`` dimensions."""
    fields = ALIKE[name] if name in ALIKE else _by_dimension(dim)[name]
    return type(name, (ctypes.Structure,), {"_fields_": list(fields)})


@cache
def array_of(kind: type[ctypes.Structure], count: int) -> Any:
    """The type of ``count`` structures; ctypes would make it again for every scene."""
    return kind * count


@cache
def enumeration(first: str) -> dict[str, int]:
    """Names and values of the enum of ``driver/tables.h`` that begins with a name."""
    text = Path(__file__).parents[1].joinpath("driver").joinpath("tables.h").read_text()
    found = re.search(rf"enum \{{ ({first}\b[^}}]*)\}}", text)
    assert found is not None, first
    values, last = {}, -1
    for one in found[1].split(","):
        name, _, given = (part.strip() for part in one.partition("="))
        last = int(given) if given else last + 1
        values[name] = last
    return values


LANES = 8  # numbers in a line of the cache
SECANTS = 23  # vectors of ``driver/secants.c``: of ten pairs, and three more


def zeros_of(sizes: Mapping[str, int | tuple[int, ...]]) -> dict[str, tuple[Array, int]]:
    """Arrays of zeros by name, one behind the other in one piece of memory, and their addresses; none is empty there."""
    spans, count = [], 0
    for name, shape in sizes.items():
        size = shape if isinstance(shape, int) else math.prod(shape)
        spans.append((name, shape, count, size))
        count += -(-(size or 1) // LANES) * LANES
    whole = np.zeros(count)
    first = address_of(whole)

    made: dict[str, tuple[Array, int]] = {}
    for name, shape, at, size in spans:
        x = whole[at : at + size]
        made[name] = x if isinstance(shape, int) else x.reshape(shape), first + 8 * at
    return made


class Store:
    """Arrays that C reads and writes: kept here as long as the tables live."""

    def __init__(self) -> None:
        self.kept: list[Any] = []

    def array(self, values: Any, dtype: Any = np.float64) -> tuple[Array, int]:
        """A contiguous copy and its address."""
        copy = np.array(values, dtype=dtype, order="C")
        self.kept.append(copy)
        return copy, address_of(copy)

    def zeros(self, sizes: Mapping[str, int | tuple[int, ...]]) -> dict[str, tuple[Array, int]]:
        """Arrays of zeros by name, as :func:`zeros_of` makes them."""
        made = zeros_of(sizes)
        self.kept += [x for x, _ in made.values()][:1]  # which keeps all of them
        return made

    def address(self, values: Any) -> int:
        """The address of a contiguous copy as C's double."""
        return self.array(values, np.float64)[1]

    def shared(self, values: Array) -> int:
        """The address of an array itself, which C only reads, where it is contiguous."""
        kept = np.ascontiguousarray(values)
        self.kept.append(kept)
        return address_of(kept)

    def structure(self, one: Any) -> int:
        """The address of a structure."""
        self.kept.append(one)
        return ctypes.addressof(one)

    def integers(self, values: Any) -> int:
        """The address of a copy as C's int."""
        return self.array(values, np.int32)[1]
