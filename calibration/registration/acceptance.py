"""Requirements that an alignment must meet to be accepted."""

OVERLAP_MIN_PX = 16
"""Follow-up pixels needed along each axis."""
