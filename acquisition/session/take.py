"""What is handed to a session to be stored: a take at the bench, or a photograph."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames
from acquisition.devices import CameraSettings, FrameImage


@dataclass(frozen=True, slots=True, kw_only=True)
class Take:
    """The average that was made for an entry of a plan, with where, when and how.

    Parameters
    ----------
    settings
        The camera's, as read back, for exposure, gain, format and black level.
    height_mm
        As read back from the stage, never the one asked for.
    focus_value
        None for flat and dark captures.
    started, finished
        The computer's clock around the exposure.
    raw_frames
        Frames to store beside it; none if empty.
    """

    averaged: AveragedFrames
    settings: CameraSettings
    height_mm: float
    focus_value: float | None
    started: datetime
    finished: datetime
    scale_px_per_mm: float | None = None
    raw_frames: Sequence[FrameImage] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Photograph:
    """A single picture that another camera took; None for what it does not tell."""

    image_dn: NDArray[np.float32]
    pixel_format: str
    max_level_dn: float
    black_level_dn: float = 0.0
    exposure_us: float | None = None
    gain_db: float | None = None
    scale_px_per_mm: float | None = None
