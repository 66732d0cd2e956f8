"""Photon transfer and correction maps from dark and flat captures."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from acquisition.files import Provenance
from acquisition.session import Session
from calibration.noise.capture_list import NoiseCapture, NoiseCaptures
from calibration.noise.correction_maps import (
    CorrectionMaps,
    Nonuniformity,
    correction_maps,
    nonuniformity,
)
from calibration.noise.document import NoiseCalibration
from calibration.noise.photon_transfer import (
    LevelSample,
    PhotonTransfer,
    Saturation,
    fit_photon_transfer,
    is_in_fit_range,
)
from simulation.arrays import BoolArray, FloatImage
from simulation.by_value import ByValue
from simulation.notebook import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

_BINS = 512
_FEWEST_IN_BIN = 30
_COLLAPSED = 0.3  # of the largest variance: read noise only, or none at all


class VarianceByLevel:
    """Temporal variance of pixels by their mean level, summed over flats.

    Because it works by pixel and not by capture, uneven light does not smear the level at which
    pixels clip.

    Parameters
    ----------
    max_level_dn
        Largest level the pixel format holds.

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
        """The level at which pixels clip: the most frequent one among those of collapsed variance.

        It is that of the pixel format if no capture reached it.
        """
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
    """The contents of noise.json, with the curve and the maps behind it."""

    calibration: NoiseCalibration
    transfer: PhotonTransfer
    maps: CorrectionMaps
    nonuniformity: Nonuniformity

    def with_provenance(self, provenance: Provenance) -> "NoiseMeasurement":
        """Return the measurement with the provenance of its document."""
        known = self.calibration.model_copy(update={"provenance": provenance})
        return replace(self, calibration=known)

    def __repr__(self) -> str:
        return f"NoiseMeasurement({self.calibration!r})"

    def _repr_html_(self) -> str:
        return self.calibration._repr_html_()

    def to_dataframe(self) -> "DataFrame":
        """Return the captures as a pandas table, a line each; see `NoiseCalibration`."""
        return self.calibration.to_dataframe()

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the variance of a frame against the light, with the fit."""
        from calibration.noise.plot import draw_photon_transfer  # matplotlib, for whoever looks
        from simulation.figures import drawn

        def draw(axes: "Axes") -> None:
            draw_photon_transfer(axes, self.transfer)
            axes.set(xlabel="level above black / DN")

        return drawn(draw, ax)


def measure_noise(
    given: Session | NoiseCaptures, progress: Callable[[int], None] = lambda _: None
) -> NoiseMeasurement:
    """Measure gain, read noise, black level, linearity, saturation and the maps of a sensor.

    Every capture is loaded twice, or three times if the sensor has defects, which are left out. Of
    a bracket every exposure is a sample, with its defects; the maps take what was merged.

    Parameters
    ----------
    given
        A session with dark and flat captures (see ``configs/noise_plan.toml``), or such captures of
        frames of one's own.
    progress
        Called with the number of captures read, two for each.

    Raises
    ------
    NoiseError
        If the captures do not determine the noise; the message says what to capture.
    SessionError
        If a capture file is missing or changed.
    """
    captures = NoiseCaptures.of_session(given) if isinstance(given, Session) else given
    listed = captures.captures
    levels = VarianceByLevel(captures.max_level_dn)
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
    capture: NoiseCapture,
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
    capture: NoiseCapture,
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

    def add(self, capture: NoiseCapture) -> None:
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
