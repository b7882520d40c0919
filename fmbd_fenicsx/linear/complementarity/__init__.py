"""Complementarity: contact forces with their sign, friction."""
