from .movements import (
    ChangedRegion as ChangedRegion,
    Movement as Movement,
    find_movements as find_movements,
)
from .surroundings import Surroundings as Surroundings
from .trial import Images as Images
