"""Studies that are paid in environment steps, all in."""
