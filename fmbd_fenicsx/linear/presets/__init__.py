"""Ways to solve a saddle point, as small frozen objects that a user chooses from."""
