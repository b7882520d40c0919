"""Elastic bodies as parts of a system: fields on frames or without, what large motion adds to them."""
