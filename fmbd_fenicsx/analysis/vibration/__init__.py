"""Small motions about a steady state: modes, linear models, rotors."""
