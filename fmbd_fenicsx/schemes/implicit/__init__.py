"""What implicit schemes in local coordinates share: the equations of a step, stages of elastic fields."""
