"""Contact of rigid points with obstacles in the compiled driver: its tables, and the march through flights, contacts and impacts.

Frames, joints and forces are those of the driver's tables; Python is entered for the poses of obstacles that move as prescribed,
and for contacts whose forces are hard to find (dependent ones with friction).
"""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...linear.complementarity.normal import ContactCounts
from ...mechanics.contact.rows import ObstaclePair
from ...mechanics.contact.shapes import Box, Cylinder, HalfSpace, Shape, Sphere
from ...rotations import Array
from ...system.compiled.calls import Calls
from ...system.compiled.items import covers
from ...system.compiled.library import driver_library
from ...system.compiled.structures import PYTHON
from ...system.compiled.tables import Tables, covers_bodies
from ...system.speed_rows import speed_rows
from ...system.system import System
from ..onestep import alpha_driver as slots
from .contact_newton import frictional_forces, normal_forces

if TYPE_CHECKING:
    from ..newton import Newton

POSE_OF, COMPLEMENTARITY = range(2)
BOUNDED = slots.AM
MOST = 64  # points; with more, the dense problem is not small
POINTER, INT, REAL, LONG = ctypes.c_void_p, ctypes.c_int, ctypes.c_double, ctypes.c_long


def _fields(text: str, kind: Any) -> list[tuple[str, Any]]:
    return [(name, kind) for name in text.split()]


class Touching(ctypes.Structure):
    """The structure Touch of ``driver/contact.c``."""

    _fields_ = _fields("gap x normal relative", POINTER)


class Tally(ctypes.Structure):
    """The structure Tally."""

    _fields_ = [*_fields("solves iterations changes cycles steps newton impacts", LONG), ("residual", REAL)]


class Contacts(ctypes.Structure):
    """The structure Contacts."""

    _fields_ = [
        *_fields("pairs points components known", INT),
        *_fields("pair frame of place", POINTER),
        *_fields("now end aside", Touching),
        *_fields("carrying closed bouncing hits held force normal impulse works", POINTER),
        *_fields("energy springs time last", REAL),
        ("loaded", INT),
        *_fields("rows drift rate W q f mu Y work ahead xi kept saved was", POINTER),
        *_fields("size most done total", INT),
        ("system", POINTER),
        ("tally", Tally),
        ("python", PYTHON),
    ]


def pair_structure(poses: int) -> type[ctypes.Structure]:
    """The structure Pair, for poses of so many numbers."""
    fields = [
        *_fields("shape first count carrier moving", INT),
        *_fields("radius friction restitution thickness", REAL),
        ("data", REAL * 8),
        ("pose", REAL * poses),
        ("asked", REAL),
    ]
    return type("Pair", (ctypes.Structure,), {"_fields_": fields})


def shape_data(shape: Shape, dim: int) -> tuple[int, list[float]] | None:
    """Kind and numbers of a shape as ``driver/contact.c`` reads them; None for shapes that it does not know."""
    if type(shape) is HalfSpace:
        point, normal = (x[:dim] for x in shape.plane)
        return 0, [*normal, float(point @ normal)]
    if type(shape) is Sphere:
        return 1, [*np.asarray(shape.center, dtype=float)[:dim], shape.radius, -1.0 if shape.inside else 1.0]
    if type(shape) is Cylinder:
        return 2, [*shape.direction, *np.asarray(shape.center, dtype=float), shape.radius, shape.length]
    if type(shape) is Box:
        half = np.asarray(shape.size, dtype=float)[:dim] / 2
        return 3, [*half, *np.asarray(shape.center, dtype=float)[:dim]]
    return None


def known(pair: Any, dim: int) -> bool:
    """Whether the driver knows a pair: points of moving frames, a shape by numbers."""
    return type(pair) is ObstaclePair and pair.slave.surface is None and shape_data(pair.shape, dim) is not None


class ContactDriver:
    """The driver for one system with contact: tables, calls into Python, and three states in turn."""

    def __init__(self, system: System, plain: System, library: Any, impacts: int) -> None:
        self.impacts = impacts
        self.system, self.library, self.contacts = system, library, system.contacts
        self.tables = Tables(plain, redundant=False)
        self.calls = Calls(self.tables)
        self.n, self.nq, self.m = system.n_v, system.n_q, system.n_lam
        self.blocks = np.zeros((3, 1 + self.nq + 3 * self.n + self.m))
        self.ring = np.array([x.ctypes.data for x in self.blocks], dtype=np.uintp)
        self.parameters = np.zeros(25)
        self.parameters[BOUNDED] = float(np.isfinite(self.contacts.thickness).any())

        self.arrays: dict[str, np.ndarray] = {}
        self.c = self._contacts()
        self.failed = PYTHON(self.answer)
        self.c.python = self.failed
        self._verdict = ctypes.c_int(0)

    def _array(self, name: str, values: Any, dtype: Any = np.float64) -> int:
        """The address of an array that is kept under its name."""
        self.arrays[name] = np.array(values, dtype=dtype, order="C")
        return int(self.arrays[name].ctypes.data)

    def _contacts(self) -> Contacts:
        """The structure, with all of its arrays."""
        s, contacts = self.system, self.contacts
        m, d = len(contacts.pair), s.motions.dim
        k = d if contacts.frictional else 1
        rows = m * k
        sides = [p.slave for p in contacts.pairs]
        self._pairs()

        sizes = {
            "held": rows, "force": m * d, "normal": m, "impulse": len(contacts.pairs) * d, "works": 5, "drift": rows, "rate": m,
            "rows": 2 * rows * s.motions.n_twist, "W": rows**2, "q": rows, "f": rows, "mu": m,
            "Y": rows * (self.n + self.m), "work": 6 * rows + rows**2, "ahead": self.nq, "xi": self.n, "kept": self.m + 1,
            "saved": rows + len(contacts.pairs) * d + 7,
        }  # fmt: skip
        counts = {"carrying": m, "closed": m, "bouncing": m, "hits": 2 * m, "was": m}
        places = {name: self._array(name, np.zeros(size)) for name, size in sizes.items()}
        return Contacts(
            pairs=len(contacts.pairs), points=m, components=k, known=0, pair=ctypes.addressof(self.pairs),
            frame=self._array("frame", np.concatenate([x.frames for x in sides]), np.int32),
            of=self._array("of", contacts.pair, np.int32),
            place=self._array("place", np.concatenate([x.points for x in sides])),
            **{name: self._array(name, np.zeros(size), np.int32) for name, size in counts.items()},
            now=self._touch("now", m, d), end=self._touch("end", m, d), aside=self._touch("aside", m, d),
            loaded=int(bool(s.forces)), size=self.n, most=2 * self.impacts, system=ctypes.addressof(self.tables.c), **places,
        )  # fmt: skip

    def _touch(self, name: str, m: int, d: int) -> Touching:
        """Room for where all points stand."""
        sizes = {"gap": m, "x": m * d, "normal": m * d, "relative": m * d}
        return Touching(**{k: self._array(f"{name} {k}", np.zeros(size)) for k, size in sizes.items()})

    def _pairs(self) -> None:
        """The pairs' structures."""
        m, first, made = self.system.motions, 0, []
        kind = pair_structure(m.n_pose)
        for pair in self.contacts.pairs:
            found = shape_data(pair.shape, m.dim)
            assert found is not None
            one = kind(
                shape=found[0], first=first, count=pair.count, moving=int(pair.moving), radius=pair.slave.radius,
                friction=pair.friction, restitution=pair.restitution, thickness=pair.thickness,
            )  # fmt: skip
            carried = 0 <= pair.carrier.frame < self.system.n_frames and not pair.moving
            one.carrier = pair.carrier.frame if carried else -1
            one.data[: len(found[1])], one.asked = found[1], np.nan
            if not carried and not pair.moving:
                # of the ground: no configuration matters
                at_rest = self.contacts.pose(self.system, pair.carrier, 0.0, np.zeros(self.nq))
                one.pose[:] = list(at_rest)
            first += pair.count
            made.append(one)
        self.pairs = (kind * len(made))(*made)

    # -- calls of C ----------------------------------------------------------------------------------------------------------
    def answer(self, what: int, number: int, t: float) -> int:
        """0, or 1 where Python raised: the step is then made in NumPy, which says why."""
        try:
            if what == POSE_OF:
                self.pairs[number].pose[:] = list(self.contacts.pairs[number].carrier.motion(t))
            else:
                self._forces(number)
        except Exception:
            return 1
        return 0

    def _forces(self, m: int) -> None:
        """Forces of m contacts with the matrix W and the openings q without force."""
        x, d = self.arrays, self.c.components
        n = m * d
        W, q, f = x["W"][: n * n].reshape(n, n), x["q"][:n], x["f"][:n].copy()
        opening, counts = q + W @ f, ContactCounts()
        if d > 1:
            found = frictional_forces(W, opening, x["mu"][:m], f.reshape(m, d), counts)
        else:
            found = normal_forces(W, opening, f, counts)
        x["f"][:n] = found.ravel()

        tally = self.c.tally
        tally.solves += counts.solves
        tally.iterations += counts.iterations
        tally.changes += counts.changes
        tally.cycles += counts.cycles
        tally.residual = max(tally.residual, counts.residual)

    # -- the march -----------------------------------------------------------------------------------------------------------
    def load(self, t: float, state: tuple[Array, Array, Array, Array]) -> None:
        """Begin from t, q, v, a, lambda."""
        q, v, a, lam = state
        np.concatenate(([t], q, v, a, np.zeros(self.n), lam), out=self.blocks[0])
        self.ring[:] = [x.ctypes.data for x in self.blocks]
        self.c.known = 0

    def march(self, h: float, steps: int, newton: Newton) -> int:
        """Make up to so many steps; the number made."""
        p = self.parameters
        p[slots.H], p[slots.THETA], p[slots.TOL], p[slots.LENGTH] = (
            h,
            newton.theta,
            newton.tolerance,
            self.system.length,
        )
        p[slots.SLOW], p[slots.MAXIT] = newton.slow, newton.max_iterations
        for slot in (slots.LOCAL, slots.ITERATIONS, slots.LEFT):
            p[slot] = 0.0
        made = self.library.moreau_march(
            ctypes.addressof(self.tables.c), ctypes.addressof(self.c), p.ctypes.data, steps, self.ring.ctypes.data,
            ctypes.byref(self._verdict),
        )  # fmt: skip
        self.calls.error = None  # NumPy's step raises it again, with the name of the law
        return int(made)

    def newest(self) -> tuple[float, Array, Array, Array, Array]:
        """t, q, v, a, lambda of the newest state."""
        first = self.blocks.ctypes.data
        x = self.blocks[(int(self.ring[0]) - first) // (8 * self.blocks.shape[1])].copy()
        at, n = 1 + self.nq, self.n
        return float(x[0]), x[1:at], x[at : at + n], x[at + n : at + 2 * n], x[at + 3 * n :]

    def touching(self) -> tuple[Array, Array, Array]:
        """Gaps (m,), places and normals (m, d) of all points at the newest state."""
        m, d = self.c.points, self.system.motions.dim

        def read(address: int, size: int) -> Array:
            return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(REAL)), (size,)).copy()

        now = self.c.now
        return read(now.gap, m), read(now.x, m * d).reshape(m, d), read(now.normal, m * d).reshape(m, d)


def contact_driver(system: System, *, redundant: bool, impacts: int) -> ContactDriver | None:
    """The driver for a system with contact and so many impacts a step, or None where the NumPy path has to do."""
    contacts, d = system.contacts, system.motions.dim
    if system.fields or redundant or len(contacts.pair) > MOST:
        return None
    if not all(known(pair, d) for pair in contacts.pairs) or system.elements:
        return None
    plain = replace(system, contacts=None, cache={})
    if not (covers_bodies(plain) and covers(plain)) or speed_rows(plain).size:
        return None
    library = driver_library(d)
    return None if library is None else ContactDriver(system, plain, library, impacts)
