"""Floor 2: bodies, placements, markers, joints, forces, contact."""
