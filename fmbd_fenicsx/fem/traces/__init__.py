"""Traces: values of fields on surfaces, and the multipliers that act on them."""
