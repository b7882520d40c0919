"""Linear solves of the constrained step: dense or sparse core, Schur complement over factored elastic blocks."""
