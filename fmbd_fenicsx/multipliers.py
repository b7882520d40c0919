"""Spaces of Lagrange multipliers on surfaces, and their inf-sup constants."""

from .fem.traces.multipliers import Aggregated, Continuous, Discontinuous, Dual, Ends, Linear
from .fem.traces.stability import infsup

__all__ = ["Aggregated", "Continuous", "Discontinuous", "Dual", "Ends", "Linear", "infsup"]
