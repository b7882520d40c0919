"""Floor 7: studies, reports, pictures, demo scripts."""
