"""Reduction: modes, reduced bodies, and what large motion adds to them."""
