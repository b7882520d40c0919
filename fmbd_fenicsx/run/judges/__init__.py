"""What steps must fulfil to count, and what is said of motions that no step can follow."""
