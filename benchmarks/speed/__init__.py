"""Time and memory, beside those of peers."""
