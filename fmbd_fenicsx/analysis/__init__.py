"""Equilibria, vibration about them, and linear models of whole scenes."""
