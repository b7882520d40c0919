"""What a run states of its errors, and how it keeps a tolerance."""
