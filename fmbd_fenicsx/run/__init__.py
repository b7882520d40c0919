"""Floor 6: the time loop and what it records."""
