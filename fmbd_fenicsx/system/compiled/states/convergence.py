"""What C and Python know of Newton's iteration for the points of an implicit step (driver/implicit/convergence.c)."""

from __future__ import annotations

import ctypes

from ..declarations import enumeration, fields_of

GOES_ON, CONVERGED, DIVERGED, TOO_SLOW = enumeration("GOES_ON").values()


class Convergence(ctypes.Structure):
    """``Convergence`` of convergence.c.

    ``done``: increments, at ``most`` so many, and the ``outcome`` after them; ``h``: of the step (s). Sizes are over the
    tolerance. With constant steps (not ``adaptive``) the size 1 is a length ``allowed`` (m); what moves less than ``still`` (m)
    is roundoff. The error left is to be below ``tolerance``, linear residuals below a share ``accurate``. Rates: ``averaged``
    over increments or not, at most ``largest``, divergence from ``limit`` on; no ``share`` of an increment that is left is
    believed below ``least``, and that of the ``first`` is given. ``foresees``: it ends where those to come would not do.
    Increments that no longer fall are roundoff below ``calm``, the one before below ``before`` times that, and with constant
    steps below ``stagnation`` or a share ``fallen`` of the greatest one. Found: ``size`` of the newest increment and of the
    ``greatest``, rate ``theta``, ``share``.
    """

    _fields_ = fields_of("implicit/convergence.c", "Convergence")
