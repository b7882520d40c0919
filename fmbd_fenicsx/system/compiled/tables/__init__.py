"""The tables that the driver reads: bodies, items, forces of a system as arrays."""
