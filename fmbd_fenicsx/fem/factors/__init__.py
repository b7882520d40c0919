"""Factors of elastic matrices, on one rank and by substructures on several."""
