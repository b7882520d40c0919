"""Controllers: their laws, what they remember, the efforts that they set."""
