"""Derivatives of the balance and of the constraints: what Newton's iteration sees."""
