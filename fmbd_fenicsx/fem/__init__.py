"""Floor 1: UFL forms become matrices; traces of surfaces, multiplier spaces, mortar integrals."""
