"""The settings of the simulated GigE camera: feature values, limits and derived values."""

from collections.abc import Mapping
from math import log10

from hil_mocks.gige.feature import Feature
from hil_mocks.gige.frame_source import FrameRequest
from hil_mocks.gige.gvcp import GvcpError, GvcpStatus
from hil_mocks.gige.gvsp import (
    GVSP_HEADER_BYTES,
    IP_UDP_HEADER_BYTES,
    chunked_bytes,
    payload_bytes_per_packet,
)
from hil_mocks.gige.pixels import PIXEL_LAYOUTS, PixelLayout

MAX_FRAME_RATE_HZ = 67.5
"""For the whole frame: Allied Vision, Manta G-046 data sheet."""

ROW_SHARE = 0.9
"""Part of the readout that shrinks with the rows of the region (our choice)."""

POWER_UP_PACKET_BYTES = 8228
POWER_UP_BANDWIDTH_BPS = 124_000_000
ETHERNET_OVERHEAD_BYTES = 38
"""Preamble, header, check sum and gap of a packet on the wire (IEEE 802.3)."""

PIXEL_NAME_OF_CODE = {layout.code: name for name, layout in PIXEL_LAYOUTS.items()}
MIDDLING_DN = 1500.0
"""Target mean level of automatic exposure and gain (our choice)."""

PROCESSING = (
    "LUTEnable",
    "LUTEnableRed",
    "Sharpness",
    "DefectCorrection",
    "TestPattern",
    "DigitalShift",
    "ReverseX",
    "ReverseY",
)
"""What changes the picture if it is switched on; see `processing`."""

SOFTWARE_TRIGGER = 6
LINE_TRIGGERS = (1, 2)


def software_triggers(values: Mapping[str, float]) -> bool:
    """Whether the software trigger triggers frames."""
    return bool(values["TriggerMode"]) and values["TriggerSource"] == SOFTWARE_TRIGGER


def trigger_waits(values: Mapping[str, float]) -> bool:
    """Whether frames wait for a trigger; an untriggered camera runs freely."""
    return bool(values["TriggerMode"]) and values["TriggerSource"] in (
        SOFTWARE_TRIGGER,
        *LINE_TRIGGERS,
    )


class CameraState:
    """The values of all features, checked when they are set.

    Behind them are the quantities that the camera works with, by the names and in the units of a
    Manta: `quantity`. It has no lock: the device locks it.

    Parameters
    ----------
    features
        The camera's table.
    shape
        ``(rows, cols)`` of the sensor.
    black_level_dn
        Black level at power-up, in DN at 12 bits.
    """

    def __init__(
        self,
        features: tuple[Feature, ...],
        *,
        shape: tuple[int, int],
        black_level_dn: float,
    ) -> None:
        self._features = {feature.name: feature for feature in features}
        self._meant = {quantity for feature in features for _, quantity in feature.means}
        # Packed formats need an even number of pixels, so the region has even steps.
        self._rows, self._cols = (size - size % 2 for size in shape)
        self._black_level_dn = black_level_dn
        self.is_acquiring = False
        self._values: dict[str, float] = {}
        self.power_up()

    def power_up(self) -> None:
        """Set all features to their values at power-up."""
        self.is_acquiring = False
        self._values = {
            "Width": self._cols,
            "Height": self._rows,
            "OffsetX": 0,
            "OffsetY": 0,
            "PixelFormat": PIXEL_LAYOUTS["Mono8"].code,
            "BinningHorizontal": 1,
            "BinningVertical": 1,
            "AcquisitionMode": 0,
            "AcquisitionFrameCount": 1,
            "TriggerSelector": 0,
            "TriggerMode": 0,
            "TriggerSource": 0,
            "AcquisitionFrameRateAbs": 30.0,
            "ExposureTimeAbs": 15_000.0,
            "ExposureAuto": 0,
            "Gain": 0.0,
            "GainAuto": 0,
            "BlackLevel": self._black_level_dn,
            **dict.fromkeys(PROCESSING, 0),
            "Gamma": 1.0,
            "GammaEnable": int("GammaEnable" not in self._meant),
            "DigitalGain": 0.0,
            "AcquisitionFrameRateEnable": 1,
            "StreamBytesPerSecond": POWER_UP_BANDWIDTH_BPS,
            "DeviceTemperature": 41.5,
            "GevSCPSPacketSize": POWER_UP_PACKET_BYTES,
        }
        for feature in self._features.values():
            if feature.power_up is not None:
                for _, quantity in feature.means:
                    self._values[quantity] = feature.conversion.quantity(feature.power_up)

    def value(self, name: str) -> float:
        """Present value of a feature, as a client reads it."""
        feature = self._features.get(name)
        if feature is None:
            return self.quantity(name)
        number = feature.conversion.number(self.quantity(self._meaning(feature)))
        return number if feature.kind == "float" else round(number)

    def quantity(self, name: str) -> float:
        """Present value of a quantity by its name and in its unit in a Manta."""
        if name in self._values:
            return self._values[name]
        return self._derived(name)

    @property
    def values(self) -> Mapping[str, float]:
        """The quantities that can be set."""
        return self._values

    def set_value(self, name: str, value: float) -> None:
        """Set a feature; floats are rounded to the camera's step.

        Raises
        ------
        GvcpError
            If the value is not accepted, or the feature is locked; nothing is set.
        """
        feature = self._features[name]
        if feature.is_locked_while_acquiring and self.is_acquiring:
            raise GvcpError(
                f"{name} is locked while frames are taken", status=GvcpStatus.WRITE_PROTECT
            )
        if feature.kind == "enumeration" and value not in dict(feature.entries).values():
            raise self._refused(name, value)
        if feature.kind == "boolean" and value not in (0, 1):
            raise self._refused(name, value)
        low, high = self._limit(feature.minimum), self._limit(feature.maximum)
        if not (low is None or value >= low) or not (high is None or value <= high):
            raise self._refused(name, value)
        if value != value:
            raise self._refused(name, value)
        if feature.increment is not None:
            steps = round(value / feature.increment)
            if feature.kind != "float" and steps * feature.increment != value:
                raise self._refused(name, value)
            value = steps * feature.increment
        self._values[self._meaning(feature)] = feature.conversion.quantity(value)

    @property
    def layout(self) -> PixelLayout:
        """How pixels are sent."""
        return PIXEL_LAYOUTS[PIXEL_NAME_OF_CODE[int(self._values["PixelFormat"])]]

    @property
    def chunks(self) -> tuple[Feature, ...]:
        """What each frame carries beside its picture."""
        if not self._values.get("ChunkModeActive"):
            return ()
        return tuple(
            feature
            for feature in self._features.values()
            if feature.chunk_id is not None and self._values.get(f"{feature.means[0][1]}Chunk")
        )

    @property
    def region(self) -> tuple[slice, slice]:
        """Rows and columns of the sensor that are sent."""
        x, y, width, height = (
            int(self._values[name]) for name in ("OffsetX", "OffsetY", "Width", "Height")
        )
        return slice(y, y + height), slice(x, x + width)

    @property
    def frame_period_s(self) -> float:
        """Time between frames: the set rate, or the limit if that is lower."""
        return 1 / self._derived("ResultingFrameRate")

    def request(self, acquisition: int, index: int) -> FrameRequest:
        """Request for a frame with the present settings."""
        return FrameRequest(
            acquisition=acquisition,
            index=index,
            exposure_us=self._values["ExposureTimeAbs"],
            gain_db=self._values["Gain"] + self._values["DigitalGain"],
            black_level_dn=self._values["BlackLevel"],
        )

    def regulate(self, mean_dn: float) -> None:
        """Adjust what is automatic, exposure before gain, for a medium level of the next frame."""
        wanted = MIDDLING_DN / max(mean_dn, 1.0)
        if self._values["ExposureAuto"]:
            exposure_us = self._values["ExposureTimeAbs"] * wanted
            self._values["ExposureTimeAbs"] = float(round(min(max(exposure_us, 21.0), 1e6)))
        elif self._values["GainAuto"]:
            gain_db = self._values["Gain"] + 20 * log10(wanted)
            self._values["Gain"] = float(round(min(max(gain_db, 0.0), 31.0)))

    @property
    def is_automatic(self) -> bool:
        """Whether the camera sets its exposure or gain itself."""
        return bool(self._values["ExposureAuto"] or self._values["GainAuto"])

    def _derived(self, name: str) -> float:
        if name in ("SensorWidth", "WidthMax"):
            return self._cols
        if name in ("SensorHeight", "HeightMax"):
            return self._rows
        if name in ("WidthLimit", "OffsetXMax"):
            return self._cols - self._values["OffsetX" if name == "WidthLimit" else "Width"]
        if name in ("HeightLimit", "OffsetYMax"):
            return self._rows - self._values["OffsetY" if name == "HeightLimit" else "Height"]
        if name == "PayloadSize":
            pixels = self._values["Width"] * self._values["Height"]
            return chunked_bytes(int(pixels * self.layout.bits_per_pixel) // 8, len(self.chunks))
        if name == "AcquisitionActive":
            return int(self.is_acquiring)
        if name == "AcquisitionFrameRateLimit":
            return self._frame_rate_limit()
        if name == "ResultingFrameRate":
            return self._frame_rate()
        if name in self._meant:
            return 0.0
        raise GvcpError(f"{name} has no value", status=GvcpStatus.INVALID_ADDRESS)

    def _meaning(self, feature: Feature) -> str:
        """The quantity that a feature stands for, as its selector is set."""
        selector = self._features.get(feature.selector)
        if selector is None or len(feature.means) < 2:
            return feature.means[0][1] if feature.means else feature.name
        selected = next(e for e, code in selector.entries if code == self.value(selector.name))
        return dict(feature.means)[selected]

    def _frame_rate(self) -> float:
        limit = self._frame_rate_limit()
        is_free = self._values["TriggerMode"] == 1 and self._values["TriggerSource"] == 0
        if is_free or not self._values["AcquisitionFrameRateEnable"]:
            return limit
        return min(self._values["AcquisitionFrameRateAbs"], limit)

    def _frame_rate_limit(self) -> float:
        share = 1 - ROW_SHARE + ROW_SHARE * (self._values["Height"] / self._rows)
        per_packet = payload_bytes_per_packet(int(self._values["GevSCPSPacketSize"]))
        payload = self._derived("PayloadSize")
        packets = -(-payload // per_packet) + 2
        headers = GVSP_HEADER_BYTES + IP_UDP_HEADER_BYTES + ETHERNET_OVERHEAD_BYTES
        bandwidth = self._values["StreamBytesPerSecond"] / (payload + packets * headers)
        return min(MAX_FRAME_RATE_HZ / share, 1e6 / self._values["ExposureTimeAbs"], bandwidth)

    def _limit(self, limit: float | str | None) -> float | None:
        return self.value(limit) if isinstance(limit, str) else limit

    @staticmethod
    def _refused(name: str, value: float) -> GvcpError:
        return GvcpError(f"{name} cannot be {value:g}", status=GvcpStatus.INVALID_PARAMETER)
