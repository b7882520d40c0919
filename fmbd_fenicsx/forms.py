"""Forms of the differential-algebraic equations: which constraints a scheme demands, and how drift is kept out."""

from .schemes.dae import GGL, Baumgarte, Index1, Index2, Index3, Overdetermined, Projected, StateSpace

__all__ = ["GGL", "Baumgarte", "Index1", "Index2", "Index3", "Overdetermined", "Projected", "StateSpace"]
