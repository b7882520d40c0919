"""Catenary: wires, droppers and what slides along them."""
