"""Computational flexible multibody dynamics on FEniCSx, by the differential-algebraic approach.

The flat names are what nearly every script uses; the others stand in the namespaces ``forces``, ``loads``, ``sensors``,
``contacts``, ``schemes``, ``forms``, ``solvers``, ``multipliers``, ``materials`` and ``study``. All are loaded at first use:
what a scene does not need is not imported. ``__init__.pyi`` lists them.
"""

from ._lazy import attach
from .leaving import install_hooks

__version__ = "0.1.0"

install_hooks()

__getattr__, __dir__, __all__ = attach(__name__, __file__)
