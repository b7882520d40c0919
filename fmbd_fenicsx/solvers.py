"""Linear solvers of a step: which factors, preconditioners and iterations; Newton's iteration."""

from .linear.saddle.presets import Bddc, Cholesky, Direct, FieldSplit, Multigrid, Schur
from .schemes.newton import ExactTangent, Newton

__all__ = ["Bddc", "Cholesky", "Direct", "ExactTangent", "FieldSplit", "Multigrid", "Newton", "Schur"]
