"""The whole matrix of a scene's step as named PETSc blocks, solved by a Krylov method with one split for each block."""
