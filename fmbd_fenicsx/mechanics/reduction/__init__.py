"""Reduction: reduced bodies by modes of elastic ones, and what they tell of these."""
