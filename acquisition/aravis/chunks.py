"""What a camera states with each frame: exposure, gain, counter, time stamp, where it has them."""

from dataclasses import dataclass

from acquisition.aravis.controls import US_PER_UNIT
from acquisition.aravis.device import OpenedDevice
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.feature_names import FeatureName, names_for
from acquisition.aravis.features import CameraFeatures
from acquisition.aravis.frame_memory import BEYOND_BYTES
from acquisition.aravis.library import AravisObject
from acquisition.errors import CameraDescriptionError

CHUNK_MODE = "ChunkModeActive"
GAIN = "Gain"
"""The only feature of which a chunk states the gain: of one by another name the unit differs."""

CHUNK_SELECTOR, CHUNK_ENABLE = "ChunkSelector", "ChunkEnable"


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFacts:
    """What a frame says of itself; None where the camera does not state it."""

    exposure_us: float | None = None
    gain: float | None = None
    counter: int | None = None
    timestamp_ticks: int | None = None


class FrameChunks:
    """The chunks of one camera.

    Parameters
    ----------
    opened
        The camera; its payload grows by the chunks that are switched on here.
    features
        Its features.
    camera
        Vendor and model, as the camera names them.

    Raises
    ------
    CameraFeatureError
        If the camera has chunks and does not switch them on.
    """

    def __init__(self, opened: OpenedDevice, features: CameraFeatures, camera: str) -> None:
        self._opened = opened
        self._parser: AravisObject | None = None
        self._rows: dict[str, tuple[FeatureName, float]] = {}
        if not features.has(CHUNK_MODE):
            return
        features.write(CHUNK_MODE, True)
        purposes = ["chunk exposure", "chunk counter", "chunk timestamp"]
        if features.has(GAIN):
            purposes.append("chunk gain")
        for purpose in purposes:
            row = next((r for r in names_for(purpose, camera) if _enable(features, r)), None)
            if row is not None:
                _require_within_frame(opened, row.name)
                unit = features.unit_of(row.name) or row.unit
                self._rows[purpose] = (row, US_PER_UNIT.get(unit, 1.0))
        if not self._rows:
            features.write(CHUNK_MODE, False)
            return
        self._is_float = {
            row.name: features.type_of(row.name) == "float" for row, _ in self._rows.values()
        }
        with translated_errors(opened.library, CHUNK_MODE):
            self._parser = opened.camera.create_chunk_parser()

    def read(self, buffer: AravisObject) -> FrameFacts | None:
        """What a complete frame says of itself; None if it lacks what was switched on."""
        if self._rows and not buffer.has_chunks():
            return None
        try:
            exposure = self._number(buffer, "chunk exposure")
            gain = self._number(buffer, "chunk gain")
            counter = self._number(buffer, "chunk counter")
            ticks = self._number(buffer, "chunk timestamp")
        except self._opened.library.glib.Error:
            return None
        return FrameFacts(
            exposure_us=exposure,
            gain=gain,
            counter=None if counter is None else int(counter),
            timestamp_ticks=None if ticks is None else int(ticks),
        )

    def close(self) -> None:
        """Drop the parser; closing twice is harmless."""
        self._parser = None
        self._rows = {}

    def _number(self, buffer: AravisObject, purpose: str) -> float | None:
        if purpose not in self._rows or self._parser is None:
            return None
        row, scale = self._rows[purpose]
        if self._is_float[row.name]:
            return float(self._parser.get_float_value(buffer, row.name)) * scale
        return int(self._parser.get_integer_value(buffer, row.name)) * round(scale)


def _require_within_frame(opened: OpenedDevice, feature: str) -> None:
    """Refuse a chunk that would be read from memory behind the frame.

    Raises
    ------
    CameraDescriptionError
        If its register is said to lie there.
    """
    for node in opened.description.nodes_of(feature):
        if node not in opened.description.in_chunks:
            continue
        with translated_errors(opened.library, feature):
            address = int(opened.device.get_feature(node).get_address())
            length = int(opened.device.get_feature(node).get_length())
        if address + length > BEYOND_BYTES:
            raise CameraDescriptionError(
                f"the camera says that {feature} lies {address} bytes into its chunk; set "
                "camera.chunk_data to false, or install its maker's firmware anew",
                fault="register",
                nodes=(feature, node),
            )


def _enable(features: CameraFeatures, row: FeatureName) -> bool:
    """Switch a chunk on; False if the camera does not have it."""
    if not features.is_described(row.name):
        return False
    if not features.has(CHUNK_SELECTOR):
        return True  # the chunks of such a camera come all together
    entries = features.entries(CHUNK_SELECTOR)
    entry = next((name for name in row.selector.split(";") if name in entries), None)
    if entry is None:
        return False
    with features.selected(CHUNK_SELECTOR, entry):
        if features.has(CHUNK_ENABLE):
            features.write(CHUNK_ENABLE, True)
    return True
