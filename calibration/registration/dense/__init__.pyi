from .agreement import (
    Agreement as Agreement,
    agreement_at as agreement_at,
    comparison_factor as comparison_factor,
    correlation_at as correlation_at,
    seen_by as seen_by,
)
from .block_votes import BlockVotes as BlockVotes, block_votes as block_votes
from .descent import (
    RefinedPose as RefinedPose,
    refined_at as refined_at,
    refined_pose as refined_pose,
    strays as strays,
)
from .level_pair import LevelPair as LevelPair
from .motions import zoom_at_centre as zoom_at_centre
from .normalised import locally_normalised as locally_normalised
from .photograph import AlignedPhotograph as AlignedPhotograph
