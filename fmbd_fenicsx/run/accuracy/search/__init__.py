"""The search for a tolerance: attempts, and the runs and spaces that they share."""
