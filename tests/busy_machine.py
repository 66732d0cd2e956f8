"""Room for a machine that does other work meanwhile, where a test bounds a time."""

BUSY_S = 20.0
"""More than any load makes a wait longer. It bounds what would otherwise never end; how long a wait
is exactly is proven on clocks of the tests' own."""
