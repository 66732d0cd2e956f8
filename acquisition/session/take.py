"""What a session is given to store: a take at the bench, or a photograph."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames
from acquisition.bracket import MergedBracket
from acquisition.devices import CameraSettings, FrameImage


@dataclass(frozen=True, slots=True, kw_only=True)
class Take:
    """The averaged frames of a plan entry, with height, times and settings.

    Parameters
    ----------
    settings
        Those of the camera, as read back: exposure, gain, format and black level.
    height_mm
        As read back from the stage, never the one requested.
    focus_value
        None for flat and dark captures.
    started, finished
        The computer's clock around the exposure.
    raw_frames
        Frames to store beside it; none if empty.
    bracket
        The exposures behind ``averaged``, if it was merged from several; ``settings`` have the
        shortest.
    """

    averaged: AveragedFrames
    settings: CameraSettings
    height_mm: float
    focus_value: float | None
    started: datetime
    finished: datetime
    scale_px_per_mm: float | None = None
    raw_frames: Sequence[FrameImage] = ()
    bracket: MergedBracket | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Photograph:
    """An image from another camera, or the mean of ``frames`` of them with their variance.

    None stands for what it does not state.
    """

    image_dn: NDArray[np.float32]
    pixel_format: str
    max_level_dn: float
    black_level_dn: float = 0.0
    exposure_us: float | None = None
    gain_db: float | None = None
    scale_px_per_mm: float | None = None
    variance_dn2: NDArray[np.float32] | None = None
    frames: int = 1
