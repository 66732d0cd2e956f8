"""Scripts run by hand in a checkout."""
