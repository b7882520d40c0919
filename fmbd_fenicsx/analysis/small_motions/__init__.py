"""Steady states and small motions about them: what equilibria and vibration stand on."""
