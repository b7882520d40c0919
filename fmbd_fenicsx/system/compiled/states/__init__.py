"""What the driver tells of states: evaluations, projections, stages, means."""
