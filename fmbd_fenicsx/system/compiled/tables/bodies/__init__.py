"""Bodies, elastic fields and rods in the tables."""
