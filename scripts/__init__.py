"""What is run by hand on a checkout."""
