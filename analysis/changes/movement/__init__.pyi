from .movements import (
    ChangedRegion as ChangedRegion,
    Movement as Movement,
    find_movements as find_movements,
)
from .seen_twice import structure_of as structure_of
from .trial import Images as Images
