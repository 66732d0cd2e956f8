from .movements import (
    ChangedRegion as ChangedRegion,
    Movement as Movement,
    find_movements as find_movements,
)
from .trial import Images as Images
