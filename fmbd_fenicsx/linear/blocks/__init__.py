"""Elastic blocks: factors and iterations for the matrices of one field."""
