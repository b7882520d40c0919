"""Time integrators. A scheme is frozen data; its stepper sees a system only through balance, constraints and the linear solve."""
