"""What makers call the features of their cameras, in which units, and what makes levels linear.

``feature_names.csv`` beside this module is the table, by purpose and in the order in which names
are tried; ``docs/camera-features.md`` names its sources. A row with a maker comes before the same
name for all makers. ``neutral`` is the value that leaves levels and pixels as the converter made
them, one for each type that the feature can have; ``if_kept`` says whether a camera that keeps
another value is refused, or the value recorded with a warning.
"""

import csv
import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal

IfKept = Literal["refuse", "record", ""]

_KEYS = {
    "exposure": "camera.exposure_us",
    "gain": "camera.gain_db",
    "frame rate": "camera.frame_rate_hz",
    "throughput": "camera.bandwidth_limit_bytes_per_s",
    "throughput switch": "camera.bandwidth_limit_bytes_per_s",
    "chunk exposure": "camera.chunk_data",
    "chunk gain": "camera.chunk_data",
    "chunk counter": "camera.chunk_data",
    "chunk timestamp": "camera.chunk_data",
    "PixelFormat": "camera.pixel_format",
    "Width": "camera.region_px",
    "Height": "camera.region_px",
    "OffsetX": "camera.region_px",
    "OffsetY": "camera.region_px",
    "PayloadSize": "camera.region_px",
    "GevSCPSPacketSize": "camera.packet_size_bytes",
    "TriggerMode": "camera.trigger",
    "TriggerSource": "camera.trigger",
    "TriggerSoftware": "camera.trigger",
    "TriggerActivation": "camera.trigger_edge",
}
"""Keys of the bench file by the purpose of a feature, or by its name where it has but one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureName:
    """One row of the table."""

    purpose: str
    name: str
    makers: tuple[str, ...]
    unit: str
    neutral: tuple[str, ...]
    selector: str
    if_kept: IfKept

    def is_of(self, camera: str) -> bool:
        """Whether the row is about a camera of this vendor and model."""
        return not self.makers or any(
            re.search(rf"\b{re.escape(maker)}\b", camera, re.IGNORECASE) for maker in self.makers
        )


def names_for(purpose: str, camera: str) -> tuple[FeatureName, ...]:
    """The rows of a purpose that are about a camera, in the order to try them.

    Parameters
    ----------
    camera
        Vendor and model, as the camera names them.
    """
    return tuple(row for row in _table() if row.purpose == purpose and row.is_of(camera))


def bench_key(feature: str) -> str | None:
    """The key of the bench file that a feature is set by; None for one that it does not tell."""
    purposes = (row.purpose for row in _table() if row.name == feature)
    keys = (_KEYS.get(word) for word in (feature, *purposes))
    return next((key for key in keys if key is not None), None)


def neutral_features(camera: str) -> tuple[FeatureName, ...]:
    """All features that have to have a neutral value in a camera, in order."""
    return tuple(row for row in _table() if row.neutral and row.is_of(camera))


@cache
def _table() -> tuple[FeatureName, ...]:
    text = files("acquisition.aravis").joinpath("feature_names.csv").read_text("utf-8")
    return tuple(
        FeatureName(
            purpose=row["purpose"],
            name=row["name"],
            makers=tuple(filter(None, row["makers"].split(";"))),
            unit=row["unit"],
            neutral=tuple(filter(None, row["neutral"].split(";"))),
            selector=row["selector"],
            if_kept=row["if_kept"],  # type: ignore[arg-type]  # the table's own word
        )
        for row in csv.DictReader(text.splitlines())
    )
