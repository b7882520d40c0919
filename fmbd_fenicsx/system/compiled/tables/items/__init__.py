"""Constraints and forces in the tables: items of kinds, in batches."""
