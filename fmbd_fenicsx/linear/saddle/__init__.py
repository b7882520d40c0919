"""Saddle points of their own, and preconditioners for them."""
