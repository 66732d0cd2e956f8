from .colour_planes import (
    ChannelDifference as ChannelDifference,
    ColourPlanes as ColourPlanes,
    colour_planes as colour_planes,
    to_channels as to_channels,
)
from .pair_colours import (
    PairColours as PairColours,
    Steps as Steps,
    to_luma_red_blue as to_luma_red_blue,
    to_rgb as to_rgb,
)
from .seen_difference import SeenDifference as SeenDifference
