"""Room for a machine that does other work meanwhile, where a test bounds a time."""

BUSY_S = 3.0
