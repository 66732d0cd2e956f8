"""How right the answers are, and how often their stated errors hold the truth."""
