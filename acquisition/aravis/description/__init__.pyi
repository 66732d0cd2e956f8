from .checking import (
    LONGEST_REGISTER_BYTES as LONGEST_REGISTER_BYTES,
    SoundDescription as SoundDescription,
    require_sound_description as require_sound_description,
)
from .fetching import read_description as read_description
