"""Results and scenes for other programs."""
