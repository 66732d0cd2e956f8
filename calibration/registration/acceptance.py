"""Requirements that an alignment must meet to be accepted."""

OVERLAP_MIN_PX = 16
"""Follow-up pixels needed along each axis."""

ELSEWHERE_MOST = 0.35
"""Largest share of the recognised blocks that may lie elsewhere than a pose puts them, of a pose
that few features spoke for. Of the right poses of ten such pairs of real photographs .27 at most,
in noise of 20 DN .07; of the wrong ones that twelve mirrored pairs were given .44 to .72, but for a
page (.05), a moon of which 3 % overlap (0), and two scenes that repeat, which is warned of."""

SURE_MATCHES = 100
"""Matched features that agree on a pose from which blocks are not asked."""
