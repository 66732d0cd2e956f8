"""Photon transfer and correction maps from dark and flat captures."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.bracket import BracketExposure
from acquisition.files import Provenance
from acquisition.frame_sums import FrameSums
from acquisition.session import CaptureRecord, Session
from calibration.errors import NoiseError
from calibration.noise._document import (
    CorrectionMaps,
    NoiseCalibration,
    Nonuniformity,
    correction_maps,
    nonuniformity,
)
from calibration.noise._emva import EmvaSheet, emva_sheet
from calibration.noise._frame_checks import FrameNames, NeighbourCorrelation, correlation_note
from calibration.noise._photon_transfer import (
    MOST_CLIPPED,
    QUANTISATION_DN2,
    LevelSample,
    PhotonTransfer,
    Saturation,
    draw_photon_transfer,
    fit_photon_transfer,
    is_in_fit_range,
)
from simulation.arrays import AnyArray, BoolArray, FloatArray, FloatImage
from simulation.by_value import ByValue
from simulation.notebook import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

NoiseKind = Literal["dark", "flat"]
_KINDS = ("dark", "flat")


@dataclass(frozen=True, slots=True, kw_only=True)
class _NoiseCapture:
    """Frames of one dark or flat level: what is known of them, and how their statistics are had.

    ``load`` returns mean and unbiased temporal variance of one frame, ``(rows, cols)`` both.
    ``saturated_pixels`` reached the largest level in any frame.
    """

    kind: NoiseKind
    name: str
    frames: int
    exposure_us: float | None
    saturated_pixels: int
    load: Callable[[], tuple[FloatImage, FloatImage]] = field(repr=False)
    time_s: float = 0.0
    bracket: tuple[BracketExposure, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCaptures:
    """Dark and flat captures of one camera at one gain, at least one of each.

    With a dark current the dark map is of the darks nearest to ``usual_exposure_us``.
    ``quantisation_dn2`` is that of the rounding, ``facts`` are further fields of noise.json.
    """

    captures: tuple[_NoiseCapture, ...]
    max_level_dn: float
    frames_averaged: int
    usual_exposure_us: float | None = None
    quantisation_dn2: float = QUANTISATION_DN2
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @classmethod
    def of_session(cls, session: Session) -> "NoiseCaptures":
        """Return the dark and flat captures of a session, which are read when they are needed."""
        records = _noise_records(session)
        camera: Mapping[str, Any] = session.devices.get("camera", {})
        wanted = session.bench.get("camera", {}).get("exposure_us")
        return cls(
            captures=tuple(_of_record(session, record) for record in records),
            max_level_dn=records[0].max_level_dn,
            frames_averaged=_frames_averaged(session.bench, records),
            usual_exposure_us=wanted if isinstance(wanted, int | float) else None,
            facts={
                "gain_db": records[0].gain_db,
                "pixel_format": records[0].pixel_format,
                "camera_serial": _text(camera, "DeviceSerialNumber"),
                "camera_model": _text(camera, "DeviceModelName"),
                "captured_utc": min(record.started_utc for record in records),
            },
        )

    def count(self, kind: NoiseKind) -> int:
        """Number of captures of a kind."""
        return sum(one.kind == kind for one in self.captures)


def _noise_records(session: Session) -> list[CaptureRecord]:
    """Return the records of the dark and flat captures of a session."""
    records = [
        record for record in session.records if record.kind in _KINDS and record.frames_used > 1
    ]
    kinds = Counter(record.kind for record in records)
    for kind, remedy in (
        ("dark", "put the lens cap on and capture with kind dark"),
        ("flat", "capture an evenly lit white surface with kind flat at several exposures"),
    ):
        if not kinds[kind]:  # type: ignore[index]  # both are kinds
            raise NoiseError(
                f"{session.path}: the session has no {kind} capture of 2 frames or more; {remedy}",
                reason="no_dark" if kind == "dark" else "no_flat",
            )
    settings = {(record.gain_db, record.pixel_format) for record in records}
    if len(settings) > 1:
        listed = ", ".join(f"{gain} dB {pixels}" for gain, pixels in sorted(settings, key=str))
        raise NoiseError(
            f"{session.path}: dark and flat captures have different settings ({listed}); "
            "a noise.json applies to one setting only: exclude the other captures",
            reason="settings",
        )
    return records


def _of_record(session: Session, record: CaptureRecord) -> _NoiseCapture:
    def load() -> tuple[FloatImage, FloatImage]:
        images = session.load(record)
        assert images.variance_dn2 is not None  # of several frames
        return images.mean_dn, images.variance_dn2

    return _NoiseCapture(
        kind="dark" if record.kind == "dark" else "flat",
        name=record.file,
        frames=record.frames_used,
        exposure_us=record.exposure_us,
        saturated_pixels=record.saturated_pixels,
        load=load,
        time_s=datetime.fromisoformat(record.started_utc).timestamp(),
        bracket=record.bracket,
    )


def _frames_averaged(bench: Mapping[str, Any], records: list[CaptureRecord]) -> int:
    frames = bench.get("capture", {}).get("frames_per_capture")
    if isinstance(frames, int) and frames >= 1:
        return frames
    return Counter(record.frames_used for record in records).most_common(1)[0][0]


def _text(snapshot: Mapping[str, object], key: str) -> str | None:
    value = snapshot.get(key)
    return None if value in (None, "") else str(value)


FEWEST_FRAMES = 2
_MOST_FRAMES = 10_000
"""Sums of 16-bit levels stay exact: N 2^16 < 2^32 and N^2 2^32 < 2^64."""
_INTEGERS = (np.uint8, np.uint16)


class FrameGroup:
    """Frames of one dark or flat level, at one exposure (None where it is not known) and gain.

    Levels of 8 and 16 bits are summed exactly, as in a capture of the bench; those of other types
    as Welford does ("Note on a method for calculating corrected sums of squares and products",
    Technometrics 4, 1962, 419).
    """

    def __init__(self, kind: NoiseKind, name: str, exposure_us: float | None = None) -> None:
        self.kind = kind
        self.name = name
        self.exposure_us = exposure_us
        self.frames = 0
        self._bits = 0
        self._largest: NDArray[Any] = np.zeros(0)
        self._sums: FrameSums | None = None
        self._mean: FloatArray = np.zeros(0)
        self._squares: FloatArray = np.zeros(0)
        self._statistics: tuple[FloatImage, FloatImage] | None = None
        self._names = FrameNames()
        self._first: NDArray[Any] = np.zeros(0)
        self.correlation: NeighbourCorrelation | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """``(rows, cols)`` of every frame."""
        return self._largest.shape

    @property
    def max_dn(self) -> float:
        """Largest level in any frame."""
        return float(self._largest.max())

    @property
    def level_bits(self) -> int:
        """The bits that are set in any level, as a whole number: what the levels step by."""
        return self._bits

    def add(self, frame_dn: AnyArray) -> None:
        """Add a frame of whole levels, shape ``(rows, cols)``."""
        if self.frames and frame_dn.shape != self.shape:
            raise NoiseError(
                f"{self.name}: frames of {_size(self.shape)} and {_size(frame_dn.shape)} pixels; "
                "give those of one camera and region",
                reason="settings",
            )
        if self.frames == _MOST_FRAMES:
            raise NoiseError(f"{self.name}: {_MOST_FRAMES} frames at most", reason="settings")
        frame: NDArray[Any] = np.ascontiguousarray(frame_dn)
        whole = np.abs(frame.astype(np.int64)) if frame.dtype.kind == "f" else frame
        if frame.dtype.kind == "f" and not np.array_equal(np.abs(frame), whole):
            raise NoiseError(
                f"{self.name}: levels that are not whole numbers, as in averaged or scaled frames; "
                "give single frames as the camera wrote them",
                reason="settings",
            )
        self._bits |= int(np.bitwise_or.reduce(whole, axis=None))
        self.frames += 1
        self._names.add(frame)
        if self.frames == 1:
            self._begin(frame)
        if self.frames == FEWEST_FRAMES:
            self.correlation = NeighbourCorrelation.of(self._first, frame)
            self._first = np.zeros(0)
        np.maximum(self._largest, frame, out=self._largest)
        if self._sums is not None:
            self._sums.add(frame)
            return
        off = frame - self._mean
        self._mean += off / self.frames
        self._squares += off * (frame - self._mean)

    def finish(self) -> None:
        """Keep the mean and the variance alone: no more frames will come."""
        if self.frames < FEWEST_FRAMES:
            raise NoiseError(
                f"{self.name}: {self.frames} frame; a {self.kind} level needs at least "
                f"{FEWEST_FRAMES}, at one exposure, for the variance from frame to frame",
                reason="no_dark" if self.kind == "dark" else "no_flat",
            )
        if self._sums is not None:
            self._statistics = self._sums.mean_and_variance(self.frames)
        else:
            variance = self._squares / (self.frames - 1)
            self._statistics = (self._mean.astype(np.float32), variance.astype(np.float32))
        self._sums, self._mean, self._squares = None, np.zeros(0), np.zeros(0)
        self._names.refuse_repeats(self.name, self.kind, self._statistics[1])

    def statistics(self) -> tuple[FloatImage, FloatImage]:
        """Mean and unbiased temporal variance of one frame, float32."""
        assert self._statistics is not None, "finish comes first"
        return self._statistics

    def saturated_pixels(self, max_level_dn: float) -> int:
        """Pixels that reached a level in any frame."""
        return int(np.count_nonzero(self._largest >= max_level_dn))

    def _begin(self, frame: NDArray[Any]) -> None:
        self._largest, self._first = frame.copy(), frame.copy()
        if frame.dtype.type in _INTEGERS:
            rows, cols = frame.shape
            self._sums = FrameSums((rows, cols), np.iinfo(frame.dtype).max)
        else:
            self._mean, self._squares = np.zeros(frame.shape), np.zeros(frame.shape)


def noise_captures(
    groups: Sequence[FrameGroup],
    *,
    max_level_dn: float,
    camera: str | None = None,
    notes: tuple[str, ...] = (),
) -> NoiseCaptures:
    """Return finished groups of frames, with names of their own, as captures of a measurement."""
    step_dn = _step_dn(groups)
    max_level_dn = max_level_dn // step_dn * step_dn
    first = groups[0]
    for group in groups[1:]:
        if group.shape != first.shape:
            raise NoiseError(
                f"{first.name} has frames of {_size(first.shape)} pixels, {group.name} of "
                f"{_size(group.shape)}; give those of one camera and region",
                reason="settings",
            )
    for group in groups:
        clipped = group.saturated_pixels(max_level_dn)
        if group.kind == "dark" and clipped > MOST_CLIPPED * group.statistics()[0].size:
            raise NoiseError(
                f"{group.name}: {clipped} pixels of a dark reach {max_level_dn:g} DN, where the "
                "camera clips; put the lens cap on, or were darks and flats swapped?",
                reason="no_dark",
                saturated=clipped,
            )
    correlated = correlation_note(
        [
            group.correlation
            for group in groups
            if group.kind == "flat" and group.correlation and group.max_dn < max_level_dn
        ]
    )
    if correlated:
        notes = (*notes, correlated)
    if step_dn > 1:
        notes = (
            *notes,
            f"the levels step by {step_dn} DN, as if {step_dn.bit_length() - 1} bits were unused; "
            "the rounding is taken to be that large",
        )
    return NoiseCaptures(
        captures=tuple(
            _NoiseCapture(
                kind=group.kind,
                name=group.name,
                frames=group.frames,
                exposure_us=group.exposure_us,
                saturated_pixels=group.saturated_pixels(max_level_dn),
                load=group.statistics,
            )
            for group in groups
        ),
        max_level_dn=max_level_dn,
        frames_averaged=1,
        quantisation_dn2=step_dn**2 * QUANTISATION_DN2,
        facts={"camera_model": camera},
        notes=notes,
    )


def _step_dn(groups: Sequence[FrameGroup]) -> int:
    """The power of two by which all levels step, as of 12 bits in the upper ones of 16."""
    bits = 0
    for group in groups:
        bits |= group.level_bits
    return bits & -bits if bits else 1


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(each) for each in reversed(shape))


_BINS = 512
_FEWEST_IN_BIN = 30
_COLLAPSED = 0.3  # of the largest variance: read noise only, or none at all


class _VarianceByLevel:
    """Temporal variance of pixels by their mean level, summed over flats.

    Because it works by pixel and not by capture, uneven light does not smear the level at which
    pixels clip.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 6.6: saturation is where the variance
    has its maximum. Pixels beyond it, whose variance has collapsed, show the level they clip at.
    """

    def __init__(self, max_level_dn: float) -> None:
        self._max_level_dn = max_level_dn
        self._count = np.zeros(_BINS)
        self._level = np.zeros(_BINS)
        self._square = np.zeros(_BINS)
        self._variance = np.zeros(_BINS)

    def add(
        self, mean_dn: NDArray[np.floating[Any]], variance_dn2: NDArray[np.floating[Any]]
    ) -> None:
        """Add the pixels of one flat."""
        mean = np.asarray(mean_dn, dtype=np.float64).ravel()
        index = np.clip((mean * (_BINS / (self._max_level_dn + 1))).astype(np.intp), 0, _BINS - 1)
        self._count += np.bincount(index, minlength=_BINS)
        self._level += np.bincount(index, mean, minlength=_BINS)
        self._square += np.bincount(index, mean**2, minlength=_BINS)
        self._variance += np.bincount(
            index, np.asarray(variance_dn2, dtype=np.float64).ravel(), minlength=_BINS
        )

    def saturation(self) -> Saturation:
        """The level at which pixels clip: the usual one of collapsed variance, or the format's."""
        unseen = Saturation(level_dn=self._max_level_dn, err_dn=None)
        used = self._count >= _FEWEST_IN_BIN
        if not used.any():
            return unseen
        variance = np.where(used, self._variance / np.maximum(self._count, 1), 0.0)
        peak = int(np.argmax(variance))
        beyond = np.arange(_BINS) > peak
        collapsed = used & beyond & (variance < _COLLAPSED * variance[peak])
        if not collapsed.any():
            return unseen
        top = int(np.argmax(np.where(collapsed, self._count, 0.0)))
        count = self._count[top]
        level = self._level[top] / count
        spread = max(self._square[top] / count - level**2, 0.0)
        return Saturation(level_dn=float(level), err_dn=float(np.sqrt(1 / 12 + spread / count)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class NoiseMeasurement(Shown, ByValue):
    """A noise calibration, with its photon-transfer curve and correction maps.

    ``calibration`` holds the contents of noise.json, ``transfer`` the fit to the dark and flat
    captures and its ``notes``, ``nonuniformity`` how much the pixels differ.
    """

    calibration: NoiseCalibration
    transfer: PhotonTransfer
    maps: CorrectionMaps
    nonuniformity: Nonuniformity

    @property
    def emva(self) -> EmvaSheet:
        """The figures of the data sheet of EMVA 1288."""
        pixels = self.nonuniformity
        return emva_sheet(self.transfer, pixels.dark_parts_dn, pixels.response_parts)

    def with_provenance(self, provenance: Provenance) -> "NoiseMeasurement":
        """Return the measurement with the provenance of its document."""
        known = self.calibration.model_copy(update={"provenance": provenance})
        return replace(self, calibration=known)

    def __repr__(self) -> str:
        return f"NoiseMeasurement({self.calibration!r})"

    def _repr_html_(self) -> str:
        return self.calibration._repr_html_()

    def to_dataframe(self) -> "DataFrame":
        """Return the captures as a pandas table, one row per capture; see `NoiseCalibration`."""
        return self.calibration.to_dataframe()

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the variance of a frame against its mean level, with the fit."""
        from simulation.figures import drawn  # matplotlib, for whoever looks

        def draw(axes: "Axes") -> None:
            draw_photon_transfer(axes, self.transfer)
            axes.set(xlabel="level above black / DN")

        return drawn(draw, ax)


def noise_of_captures(
    given: Session | NoiseCaptures, progress: Callable[[int], None] = lambda _: None
) -> NoiseMeasurement:
    """Measure gain, read noise, black level, linearity, saturation and the maps of a sensor.

    Every capture is loaded twice, or three times if the sensor has defects, which are left out. In
    a bracket every exposure is a sample, with its defects; the maps use the merged capture. A
    `NoiseError` says what to capture.
    """
    captures = NoiseCaptures.of_session(given) if isinstance(given, Session) else given
    listed = captures.captures
    levels = _VarianceByLevel(captures.max_level_dn)
    samples: list[LevelSample] = []
    for done, capture in enumerate(listed, start=1):
        mean, variance = capture.load()
        samples += _samples(capture, mean, variance)
        if capture.kind == "flat" and capture.bracket is None:
            levels.add(mean, variance)
        progress(done)
    rounding = captures.quantisation_dn2
    transfer = fit_photon_transfer(samples, levels.saturation(), rounding)
    sums = _MapSums(transfer, _dark_group(transfer, captures))
    for done, capture in enumerate(listed, start=len(listed) + 1):
        sums.add(capture)
        progress(done)
    maps = sums.maps()
    if maps.is_defect.any():
        sound = ~maps.is_defect
        masked = [one for each in listed for one in _samples(each, *each.load(), sound)]
        transfer = fit_photon_transfer(masked, transfer.saturation, rounding)
    transfer = replace(transfer, notes=(*transfer.notes, *captures.notes))
    pixels = sums.nonuniformity(maps)
    calibration = NoiseCalibration.of(
        transfer,
        pixels,
        frames_averaged=captures.frames_averaged,
        darks=captures.count("dark"),
        flats=captures.count("flat"),
        **captures.facts,
    )
    return NoiseMeasurement(
        calibration=calibration, transfer=transfer, maps=maps, nonuniformity=pixels
    )


def _samples(
    capture: _NoiseCapture,
    mean_dn: FloatImage,
    variance_dn2: FloatImage,
    sound: BoolArray | None = None,
) -> list[LevelSample]:
    """The samples of a capture: one, or one for each exposure of a bracket."""
    whole = _sample(capture, mean_dn, variance_dn2, sound)
    if capture.bracket is None:
        return [whole]
    return [
        whole.model_copy(
            update={
                "mean_dn": one.mean_dn,
                "variance_dn2": one.variance_dn2,
                "pixels": mean_dn.size,
                "frames": one.frames_used,
                "exposure_us": one.exposure_us,
                "clipped_fraction": one.saturated_pixels / mean_dn.size,
            }
        )
        for one in capture.bracket
    ]


def _sample(
    capture: _NoiseCapture,
    mean_dn: FloatImage,
    variance_dn2: FloatImage,
    sound: BoolArray | None = None,
) -> LevelSample:
    mean, variance = (
        (mean_dn, variance_dn2) if sound is None else (mean_dn[sound], variance_dn2[sound])
    )
    return LevelSample(
        kind=capture.kind,
        capture=capture.name,
        mean_dn=float(mean.mean(dtype=np.float64)),
        variance_dn2=float(variance.mean(dtype=np.float64)),
        pixels=mean.size,
        frames=capture.frames,
        exposure_us=capture.exposure_us,
        time_s=capture.time_s,
        clipped_fraction=capture.saturated_pixels / mean_dn.size,
    )


def _dark_group(transfer: PhotonTransfer, captures: NoiseCaptures) -> frozenset[str]:
    """Dark captures to average into the map: all, or with a dark current those of one exposure."""
    darks = [one for one in captures.captures if one.kind == "dark"]
    wanted = captures.usual_exposure_us
    exposures = [one.exposure_us for one in darks if one.exposure_us is not None]
    if transfer.dark.rate_dn_per_us == 0 or wanted is None or len(exposures) < len(darks):
        return frozenset(one.name for one in darks)
    nearest = min(exposures, key=lambda exposure: abs(exposure - wanted))
    return frozenset(one.name for one in darks if one.exposure_us == nearest)


class _MapSums:
    """Sums over captures, from which the maps are computed."""

    def __init__(self, transfer: PhotonTransfer, dark_files: frozenset[str]) -> None:
        self._transfer = transfer
        self._dark_files = dark_files
        self._dark: Any = 0.0
        self._dark_frames = 0
        self._flat: Any = 0.0
        self._flat_level_dn = 0.0
        self._flat_variance_dn2 = 0.0
        self._flats = 0
        self._ratio: Any = 0.0
        self._captures = 0

    def add(self, capture: _NoiseCapture) -> None:
        """Add a capture, if it is suitable for a map."""
        mean_dn, variance_dn2 = capture.load()
        sample = _sample(capture, mean_dn, variance_dn2)
        black = self._transfer.dark.black_level_dn
        is_dark = sample.kind == "dark"
        if not (is_dark or is_in_fit_range(sample, black, self._transfer.saturation.level_dn)):
            return
        mean = mean_dn.astype(np.float64)
        if capture.bracket is None:  # its variance is the model's, and judges no pixel
            expected = self._transfer.variance_dn2(np.maximum(mean - black, 0.0))
            self._ratio = self._ratio + variance_dn2 / np.maximum(expected, 1e-6)
            self._captures += 1
        if is_dark:
            if sample.capture in self._dark_files:
                self._dark = self._dark + mean * sample.frames
                self._dark_frames += sample.frames
            return
        self._flat = self._flat + mean
        self._flat_level_dn += sample.mean_dn
        self._flat_variance_dn2 += sample.variance_dn2 / sample.frames
        self._flats += 1

    def maps(self) -> CorrectionMaps:
        """The maps, once every capture has been added."""
        dark = self._dark / self._dark_frames
        light = self._flat - self._flats * dark
        return correction_maps(
            dark,
            light / light.mean(),
            dark_noise_dn=float(np.sqrt(max(self._transfer.offset_dn2, 0.0))),
            variance_ratio=(self._ratio / self._captures if self._captures else np.ones_like(dark)),
            black_level_dn=float(dark.mean()),
        )

    def nonuniformity(self, maps: CorrectionMaps) -> Nonuniformity:
        """Nonuniformity of the maps, without the temporal noise left in them."""
        dark_dn2 = max(self._transfer.offset_dn2, 0.0) / self._dark_frames
        light_dn = self._flat_level_dn - self._flats * maps.black_level_dn
        left_dn2 = self._flat_variance_dn2 + self._flats**2 * dark_dn2
        return nonuniformity(
            maps, dark_variance_dn2=dark_dn2, response_variance=left_dn2 / light_dn**2
        )
