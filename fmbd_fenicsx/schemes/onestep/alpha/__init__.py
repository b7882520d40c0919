"""Generalized-alpha: the scheme, its step, its steppers in NumPy and in compiled code, steps of its own choice."""
