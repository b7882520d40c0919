"""Forces between markers."""
