"""Requirements that an alignment must meet to be accepted."""

OVERLAP_MIN_PX = 16
"""Follow-up pixels needed along each axis."""

ELSEWHERE_MOST = 0.3
"""Largest share of the recognised blocks that may lie elsewhere than a pose puts them, of a pose
that few features spoke for."""
