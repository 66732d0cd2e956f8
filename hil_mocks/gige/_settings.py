"""The simulated GigE camera inside: its faults, what makes its frames, its settings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from math import log10
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from hil_mocks.gige._features import Feature
from hil_mocks.gige._wire import (
    GVSP_HEADER_BYTES,
    IP_UDP_HEADER_BYTES,
    PIXEL_LAYOUTS,
    GvcpError,
    GvcpStatus,
    PixelLayout,
    chunked_bytes,
    payload_bytes_per_packet,
)
from hil_mocks.truth import ADC_MAX_DN, Sensor

RATES = ("packet_loss_rate", "duplicate_rate", "reorder_rate")


@dataclass(frozen=True, slots=True, kw_only=True)
class GigeFaults:
    """Faults from now on; a restart and a loss of control are methods of the device."""

    seed: int = 0  # of the three rates
    packet_loss_rate: float = 0.0  # part of the stream's packets; resent ones can be lost too
    duplicate_rate: float = 0.0  # part that comes twice
    reorder_rate: float = 0.0  # part that comes after the one that follows it
    resend_disabled: bool = False  # does not support the command for resending
    is_stalled: bool = False  # no frame is taken
    is_dead: bool = False  # nothing answers and nothing is sent: no power, or the cable is pulled
    heartbeat_lost: bool = False  # commands no longer keep control alive
    corrupt_leader: bool = False  # leaders have a payload type that does not exist
    missing_rows: int = 0  # the image has so many fewer than was set
    refused_registers: frozenset[str] = frozenset()  # features that refuse every write
    slow_writes_s: float = 0.0  # before a write is answered; a pending acknowledge comes if it may
    temperature_present: bool = False  # the description has a DeviceTemperature, unlike a Manta's
    exposure_delay_frames: int = 0  # frames have the exposure of so many earlier
    gain_delay_frames: int = 0  # frames have the gain of so many earlier

    def __post_init__(self) -> None:
        for name in RATES:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be from 0 to 1, got {getattr(self, name)}")
        for name in (
            "seed",
            "missing_rows",
            "slow_writes_s",
            "exposure_delay_frames",
            "gain_delay_frames",
        ):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")

    @property
    def disturbs_packets(self) -> bool:
        """Whether the packets of a block do not simply arrive in order."""
        return any(getattr(self, name) > 0 for name in RATES)

    def order_of_arrival(self, packet_count: int, draw: int) -> list[int]:
        """Return which of the packets 0 to ``packet_count - 1`` arrive, in that order.

        The same seed and ``draw`` give the same order.
        """
        rng = np.random.default_rng([self.seed, draw])
        lost, twice, late = (rng.random(packet_count) < getattr(self, name) for name in RATES)
        positions = np.arange(packet_count, dtype=np.float64)
        positions[late] += 1.5
        arriving = np.repeat(np.flatnonzero(~lost), np.where(twice[~lost], 2, 1))
        return [int(packet) for packet in arriving[np.argsort(positions[arriving], kind="stable")]]

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of the faults."""
        return tuple(field.name for field in fields(cls))


NOISE_LEVELS = 65536
CERTAIN_SIGMA = 8.0
"""Beyond this many standard deviations the full well no longer matters in float32."""

BAYER_WEIGHTS = {"R": 0.55, "G": 1.0, "B": 0.7}
"""Transmission of a colour filter for white paper, relative to green (our choice)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRequest:
    """Everything that a frame depends on except the scene; levels in DN at 12 bits."""

    acquisition: int  # number of the start since power-up, from 1
    index: int  # of the frame since that start, from 0: the block id is one more until ids wrap
    exposure_us: float
    gain_db: float
    black_level_dn: float


class FrameSource(Protocol):
    """Makes a camera's frames; while the scene is still, each depends only on its request."""

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the sensor."""
        ...

    def levels_dn(self, request: FrameRequest) -> NDArray[np.uint16]:
        """Levels of the whole sensor in DN at 12 bits."""
        ...


@cache
def noise_table() -> NDArray[np.float32]:
    """Standard normal deviate for each of 65536 equally likely draws: mean 0, variance 1.

    The largest is 4.2: the tails beyond, 3 in 100 000 draws, are pulled in.
    """
    quantiles = ndtri((np.arange(NOISE_LEVELS) + 0.5) / NOISE_LEVELS)
    table = np.asarray(quantiles / quantiles.std(), np.float32)
    table.setflags(write=False)
    return table


class BenchFrameSource:
    """Photographs the view of a simulated bench, with noise according to the sensor model.

    Every pixel of every frame draws 16 random bits of its own, a normal deviate by `noise_table`:
    shot and read noise together are a Gaussian of the model's variance. So mean and variance are
    the model's down to a few electrons, but the skewness of the Poisson distribution is missing.
    The clipping by the full well is included in the mean and the variance of its pixels. ``look``
    gives the light on each pixel, the same array while nothing moves; ``bayer_order`` the first two
    colours of the mosaic, None for a monochrome sensor.
    """

    def __init__(
        self,
        sensor: Sensor,
        look: Callable[[], NDArray[np.float32]],
        *,
        seed: int,
        bayer_order: str | None = None,
    ) -> None:
        self._sensor = sensor
        self._look = look
        self._seed = seed
        view = look()
        self._shape = (view.shape[0], view.shape[1])
        self._filter = None if bayer_order is None else _mosaic(self._shape, bayer_order)
        self._prepared: _Prepared | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """See `FrameSource.shape`."""
        return self._shape

    def levels_dn(self, request: FrameRequest) -> NDArray[np.uint16]:
        """See `FrameSource.levels_dn`; the scene is read once, at the start."""
        view = self._look()
        prepared = self._prepared
        settings = (request.exposure_us, request.gain_db, request.black_level_dn)
        if prepared is None or prepared.view is not view or prepared.settings != settings:
            prepared = self._prepare(view, request)
            self._prepared = prepared
        stream = np.random.SFC64([self._seed, request.acquisition, request.index])
        draws = stream.random_raw(-(-view.size // 4)).view(np.uint16)[: view.size]
        level_dn = np.take(noise_table(), draws, mode="clip").reshape(view.shape)
        level_dn *= prepared.sigma_dn
        level_dn += prepared.mean_dn  # plus a half, as the conversion below truncates
        np.clip(level_dn, 0, ADC_MAX_DN, out=level_dn)
        return level_dn.astype(np.uint16)

    def _prepare(self, view: NDArray[np.float32], request: FrameRequest) -> "_Prepared":
        electrons = self._sensor.electrons(view, request.exposure_us).astype(np.float64)
        if self._filter is not None:
            electrons *= self._filter
        mean_e, variance_e2 = _filled(electrons, self._sensor.full_well_e)
        gain = self._sensor.gain_at_e_per_dn(request.gain_db)
        sigma_e = np.sqrt(variance_e2 + self._sensor.read_noise_e**2)
        return _Prepared(
            view=view,
            settings=(request.exposure_us, request.gain_db, request.black_level_dn),
            mean_dn=(request.black_level_dn + 0.5 + mean_e / gain).astype(np.float32),
            sigma_dn=(sigma_e / gain).astype(np.float32),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Prepared:
    view: NDArray[np.float32]
    settings: tuple[float, float, float]
    mean_dn: NDArray[np.float32]
    sigma_dn: NDArray[np.float32]


def _filled(
    electrons: NDArray[np.float64], full_well_e: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and variance of ``min(X, full well)`` with X normal, mean and variance ``electrons``."""
    sigma = np.sqrt(np.maximum(electrons, 1e-6))
    room = np.clip((full_well_e - electrons) / sigma, -CERTAIN_SIGMA, CERTAIN_SIGMA)
    if room.min() >= CERTAIN_SIGMA:
        return electrons, electrons
    below, density = ndtr(room), np.exp(-(room**2) / 2) / np.sqrt(2 * np.pi)
    # E[min(Z, a)] and E[min(Z, a)^2] of a standard normal Z.
    first = room * (1 - below) - density
    second = below - room * density + room**2 * (1 - below)
    mean = np.where(room <= -CERTAIN_SIGMA, full_well_e, electrons + sigma * first)
    return mean, np.maximum(second - first**2, 0) * sigma**2


def _mosaic(shape: tuple[int, int], order: str) -> NDArray[np.float64]:
    """Weight of each pixel's colour filter; ``order`` is the first row's first two colours."""
    other = "B" if "R" in order else "R"
    second = ("G" + other) if order[1] == "G" else (other + "G")
    weights = np.array([[BAYER_WEIGHTS[colour] for colour in row] for row in (order, second)])
    return np.tile(weights, (shape[0] // 2 + 1, shape[1] // 2 + 1))[: shape[0], : shape[1]]


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
    Manta: `quantity`. It has no lock: the device locks it. ``black_level_dn`` is at 12 bits.
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

        GvcpError if the value is not accepted, or the feature is locked; nothing is set.
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
