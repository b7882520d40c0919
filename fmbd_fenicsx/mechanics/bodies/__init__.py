"""Bodies: what each kind is, in formulas."""
