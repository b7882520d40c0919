"""Contact: shapes, gaps and their rows."""
