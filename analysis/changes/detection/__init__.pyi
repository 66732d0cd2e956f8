from .chance import (
    FilterWidth as FilterWidth,
    equally_strict as equally_strict,
    significance_threshold as significance_threshold,
)
from .false_discovery import (
    discovery_threshold as discovery_threshold,
    q_values as q_values,
)
from .level_colours import LevelColours as LevelColours
from .levels import (
    DetectionLevel as DetectionLevel,
    detection_levels as detection_levels,
    usual_widths as usual_widths,
)
from .limit_maps import LimitMaps as LimitMaps, detection_limit as detection_limit
from .linked_regions import (
    FoundChanges as FoundChanges,
    LinkedRegion as LinkedRegion,
    link_levels as link_levels,
    pixels_of as pixels_of,
)
from .power import (
    POWER as POWER,
    detection_power as detection_power,
    height_for as height_for,
    response as response,
)
