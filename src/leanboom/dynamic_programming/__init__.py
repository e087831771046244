"""Dynamic programming over position and velocity of the redundant cylinder."""
