"""Quanta, detection and information of a camera, from its calibrations or its edges alone."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, sqrt
from typing import Final, Literal, NamedTuple

import numpy as np

from acquisition.files import StoredModel
from calibration.capacity import (
    ROSE_SNR,
    Bar,
    Disc,
    NoisePower,
    SignalAndNoise,
    Transfer,
    edge_information_bits_per_px,
    edge_location_err_px,
    edge_shift_snr,
    ideal_observer_snr,
    information_bits_per_px,
)
from calibration.edges import AxisTransfer, EdgeMeasurement
from calibration.errors import PsfFileError
from calibration.noise import NoiseCalibration
from calibration.psf import PsfCalibration
from calibration.sharpness import MeasuredValue, sharpening_of
from simulation.arrays import FloatArray

CONTRAST: Final = 0.1
"""Contrast of the objects whose SNR is stated."""
EDGE_LENGTH_PX: Final = 100.0
EDGE_SHIFT_PX: Final = 0.1

LevelOf = Literal["the bright side of the edges", "the mean of both sides of the edges"]

_DISCS_PX = (2.0, 5.0, 10.0)
_BAR_PX = (1.0, 10.0)
_FREQ = np.arange(51) / 100
_TURNS = (np.arange(16) + 0.5) * np.pi / 16
_SAME_NOISE = 1.3
"""Ratio up to which the photographs' own noise is that of the noise calibration."""


class DetectionFigure(StoredModel):
    """How well an ideal observer sees an object in one photograph.

    ``snr`` is that at the contrast ``contrast``, of the light at which the camera was measured;
    ``threshold_contrast`` the contrast that is seen with an SNR of 5.
    """

    target: Literal["disc", "bar", "edge"]
    description: str
    contrast: float
    snr: MeasuredValue
    threshold_contrast: float


class CapacityFigures(StoredModel):
    """Noise-equivalent quanta, detection and information of a camera at one level of light.

    Parameters
    ----------
    level_dn, level_of
        Level above black that quanta and detection hold at, and what it is of the edges: their
        bright side or, where their own noise counts, the mean of both sides.
    noise_dn, noise_from
        Noise of a photograph at that level, and its source.
    range_dn
        Between the levels of the edges, median; the information is that of this range.
    freq_cy_per_px, neq, neq_err
        Noise-equivalent quanta a pixel, mean over the directions, with standard errors.
    detection, edge_location_err_px
        What an ideal observer sees; and the least error of the place of an edge 100 px long whose
        step is a tenth of the light.
    edge_bits_per_px
        Information capacity by edges alone (Koren's method), median over them.
    bits_per_px
        The same by transfer and noise over all frequencies of the sampling. The noise of both is
        the mean square over the levels of the edges.
    most_bits_per_px
        As that, for all levels from black to saturation; None where no capture reached it.
    is_round
        Whether the lens was taken as round, because the edges show one direction only.
    """

    level_dn: float
    level_of: LevelOf
    noise_dn: float
    noise_from: str
    range_dn: float
    freq_cy_per_px: tuple[float, ...]
    neq: tuple[float, ...]
    neq_err: tuple[float, ...]
    detection: tuple[DetectionFigure, ...]
    edge_location_err_px: float
    edge_bits_per_px: MeasuredValue | None = None
    bits_per_px: MeasuredValue
    most_bits_per_px: float | None = None
    is_round: bool = False


def capacity_figures(
    psf: PsfCalibration, noise: NoiseCalibration | None
) -> tuple[CapacityFigures | None, tuple[str, ...]]:
    """Return the figures of a calibrated PSF and noise, and remarks on them.

    Without a noise calibration, or with one that is not of these photographs (their own noise is
    1.3 times as much or as little), the noise is that of the pixels around the edges. None where
    there is no edge with levels, none has noise, or the photographs are processed: stored with a
    tone curve, as JPEG, or sharpened.
    """
    edges = [edge for edge in psf.edges_used if edge.levels_dn is not None]
    if (processing := _processing_of(psf)) is not None:
        return None, (f"no noise-equivalent quanta: the photographs are {processing}",)
    light = _Light.of(edges, noise)
    if light is None:
        return None, ("no noise-equivalent quanta: the photographs show no noise",)
    transfer = _transfer_of(psf)
    if transfer is None:
        return None, ("no noise-equivalent quanta: the edges do not determine the transfer",)
    camera = SignalAndNoise(
        transfer=transfer.transfer,
        transfer_err=transfer.err,
        noise=light.noise,
        signal_dn=light.level_dn,
    )
    neq, neq_err = _mean_over_directions(camera)
    figures = CapacityFigures(
        level_dn=light.level_dn,
        level_of=light.level_of,
        noise_dn=sqrt(light.noise.variance_dn2),
        noise_from=light.noise_from,
        range_dn=light.range_dn,
        freq_cy_per_px=tuple(np.round(_FREQ, 2).tolist()),
        neq=tuple(neq.tolist()),
        neq_err=tuple(neq_err.tolist()),
        detection=_detection(camera),
        edge_location_err_px=edge_location_err_px(camera, CONTRAST, EDGE_LENGTH_PX),
        edge_bits_per_px=_edge_bits(edges),
        bits_per_px=_bits(replace(camera, noise=light.mean_noise), light.range_dn),
        most_bits_per_px=_most_bits(camera, noise) if light.is_calibrated else None,
        is_round=transfer.is_round,
    )
    remarks = light.remarks
    if transfer.is_round:
        remarks = (
            *remarks,
            "edges in one direction only: for the quanta, the PSF is assumed to be round",
        )
    if any(edge.red_shift_px is not None for edge in edges):
        remarks = (
            *remarks,
            "colour photographs: quanta and information are rough, because pixels interpolated "
            "from a mosaic have noise that is not white; raw files are not interpolated",
        )
    return figures, remarks


def _processing_of(psf: PsfCalibration) -> str | None:
    """What was done to the photographs after which levels and noise no longer tell quanta."""
    if any("jpeg" in edge.flags for edge in psf.edges_used):
        return "JPEG, whose compression changes the noise; give raw or linear files"
    encoding = "linear" if psf.provenance is None else psf.provenance.encoding
    curves = {encoding} if isinstance(encoding, str) else set(encoding)
    if curves - {"linear"}:
        return "stored with a tone curve, so that they are processed; give raw or linear files"
    sharpening = sharpening_of(psf.edges_used)
    if sharpening is not None and sharpening.is_found:
        return "sharpened, which changes signal and noise alike; give raw or linear files"
    return None


class _Light(NamedTuple):
    """The levels of the edges and the noise there.

    ``noise`` is that at ``level_dn``; ``mean_noise`` is the mean square over the levels.
    """

    level_dn: float
    level_of: LevelOf
    range_dn: float
    noise: NoisePower
    mean_noise: NoisePower
    noise_from: str
    is_calibrated: bool
    remarks: tuple[str, ...]

    @classmethod
    def of(
        cls, edges: Sequence[EdgeMeasurement], noise: NoiseCalibration | None
    ) -> "_Light | None":
        levels = np.array([edge.levels_dn for edge in edges]).reshape(-1, 2)
        own_dn = [
            abs(high - low) / edge.snr
            for edge, (low, high) in zip(edges, levels.tolist(), strict=True)
            if edge.snr
        ]
        if not own_dn:  # darks and flats would be of another camera
            return None
        low_dn, high_dn = np.median(np.sort(levels, axis=1), axis=0).tolist()
        remarks: list[str] = []
        if noise is None:
            remarks.append("black level unknown: taken as 0 for quanta; give darks and flats")
        elif not _is_same(noise, levels, own_dn):
            remarks.append(
                f"the photographs' own noise ({np.median(own_dn):.3g} DN at the edges) is not that "
                "of the darks and flats: a different gain, averaging or processing; the quanta are "
                "computed with the photographs' own noise"
            )
        else:
            return cls(
                level_dn=high_dn - noise.black_level_dn,
                level_of="the bright side of the edges",
                range_dn=high_dn - low_dn,
                noise=_power(noise, [high_dn]),
                mean_noise=_power(noise, [low_dn, high_dn]),
                noise_from="darks and flats",
                is_calibrated=True,
                remarks=(),
            )
        # The variance is linear in the level: its mean over both sides is that of their mean level.
        own = NoisePower(variance_dn2=float(np.median(own_dn)) ** 2, relative_err=_scatter(own_dn))
        black_dn = 0.0 if noise is None else noise.black_level_dn
        return cls(
            level_dn=0.5 * (low_dn + high_dn) - black_dn,
            level_of="the mean of both sides of the edges",
            range_dn=high_dn - low_dn,
            noise=own,
            mean_noise=own,
            noise_from="the pixels around the edges",
            is_calibrated=False,
            remarks=tuple(remarks),
        )


def _power(noise: NoiseCalibration, levels_dn: Sequence[float]) -> NoisePower:
    """Mean square of the calibrated noise over levels."""
    return NoisePower(
        variance_dn2=float(noise.capture_noise.variance_dn2(np.array(levels_dn)).mean()),
        relative_err=noise.relative_err(levels_dn) or 0.0,
    )


def _is_same(noise: NoiseCalibration, levels_dn: FloatArray, own_dn: Sequence[float]) -> bool:
    """Whether edges have the noise that was calibrated, within a factor."""
    known_dn = np.sqrt(noise.capture_noise.variance_dn2(levels_dn).mean(axis=1))
    ratio = float(np.median(own_dn) / np.median(known_dn))
    return 1 / _SAME_NOISE < ratio < _SAME_NOISE


def _scatter(values: Sequence[float]) -> float:
    """Relative standard error of a mean of few values; 0 of a single one."""
    if len(values) < 2:
        return 0.0
    return float(np.std(values, ddof=1) / np.mean(values) / sqrt(len(values)))


class _KnownTransfer(NamedTuple):
    transfer: Transfer
    err: Transfer | None
    is_round: bool


def _transfer_of(psf: PsfCalibration) -> _KnownTransfer | None:
    """Transfer of lens and pixel; edges of one direction show that of a round lens."""
    if psf.transfer_2d is not None:
        return _KnownTransfer(psf.transfer_2d.otf, psf.transfer_2d.otf_err, is_round=False)
    try:
        return _KnownTransfer(psf.total_psf("psf").otf, None, is_round=False)
    except PsfFileError:
        known = psf.transfer
        axis = None if known is None else known.x or known.y
        return None if axis is None else _KnownTransfer(_round(axis), None, is_round=True)


def _round(axis: AxisTransfer) -> Transfer:
    freq, mtf = np.array(axis.freq_cy_per_px), np.array(axis.mtf)

    def transfer(fx: FloatArray, fy: FloatArray) -> FloatArray:
        return np.asarray(np.interp(np.hypot(fx, fy), freq, mtf, right=0.0))

    return transfer


def _mean_over_directions(camera: SignalAndNoise) -> tuple[FloatArray, FloatArray]:
    fx, fy = np.outer(np.cos(_TURNS), _FREQ), np.outer(np.sin(_TURNS), _FREQ)
    return camera.neq(fx, fy).mean(axis=0), camera.neq_err(fx, fy).mean(axis=0)


def _detection(camera: SignalAndNoise) -> tuple[DetectionFigure, ...]:
    sharper = camera.sharper_by_err()
    discs = [
        _detected(
            "disc",
            f"disc of {size:g} px",
            [ideal_observer_snr(one, Disc(diameter_px=size), CONTRAST) for one in (camera, sharper)
             if one],
            camera,
        )
        for size in _DISCS_PX
    ]  # fmt: skip
    bar = Bar(width_px=_BAR_PX[0], length_px=_BAR_PX[1])
    edges = [
        edge_shift_snr(one, CONTRAST, EDGE_LENGTH_PX, EDGE_SHIFT_PX)
        for one in (camera, sharper)
        if one
    ]
    bars = [ideal_observer_snr(one, bar, CONTRAST) for one in (camera, sharper) if one]
    return (
        *discs,
        _detected("bar", f"bar of {_BAR_PX[0]:g} by {_BAR_PX[1]:g} px", bars, camera),
        _detected(
            "edge",
            f"edge of {EDGE_LENGTH_PX:g} px, moved by {EDGE_SHIFT_PX:g} px",
            edges,
            camera,
        ),
    )


def _detected(
    target: Literal["disc", "bar", "edge"],
    description: str,
    snrs: Sequence[float],
    camera: SignalAndNoise,
) -> DetectionFigure:
    """An SNR, and its error from that of the noise and of the transfer (the second SNR)."""
    snr = snrs[0]
    err = hypot(camera.noise.relative_err * snr, snrs[-1] - snr)
    return DetectionFigure(
        target=target,
        description=description,
        contrast=CONTRAST,
        snr=MeasuredValue(value=snr, err=err),
        threshold_contrast=CONTRAST * ROSE_SNR / snr,
    )


def _edge_bits(edges: Sequence[EdgeMeasurement]) -> MeasuredValue | None:
    """Median over edges of the capacity that each shows by itself, with its error by scatter."""
    found = []
    for edge in edges:
        if edge.esfr is None or edge.levels_dn is None or not edge.snr:
            continue
        range_dn = abs(edge.levels_dn[1] - edge.levels_dn[0])
        bits = edge_information_bits_per_px(edge.esfr.at, range_dn, range_dn / edge.snr)
        found.append(bits)
    if not found:
        return None
    middle = float(np.median(found))
    return MeasuredValue(value=middle, err=middle * _scatter(found))


def _bits(camera: SignalAndNoise, range_dn: float) -> MeasuredValue:
    """Capacity, with its error by those of the noise and of the transfer."""
    value = information_bits_per_px(camera, range_dn)
    variance = camera.noise.variance_dn2 * (1 + camera.noise.relative_err) ** 2
    noisier = replace(camera, noise=replace(camera.noise, variance_dn2=variance))
    err = value - information_bits_per_px(noisier, range_dn)
    sharper = camera.sharper_by_err()
    if sharper is not None:
        err = hypot(err, information_bits_per_px(sharper, range_dn) - value)
    return MeasuredValue(value=value, err=err)


def _most_bits(camera: SignalAndNoise, noise: NoiseCalibration | None) -> float | None:
    """Capacity for all levels up to a saturation that was seen, with the mean noise over them."""
    if noise is None or noise.saturation_dn is None or noise.saturation_is_reached is False:
        return None
    range_dn = noise.saturation_dn - noise.black_level_dn
    middle_dn = np.array(noise.black_level_dn + 0.5 * range_dn)  # the variance is linear in it
    mean = NoisePower(variance_dn2=float(noise.capture_noise.variance_dn2(middle_dn)))
    full = SignalAndNoise(transfer=camera.transfer, noise=mean, signal_dn=0.5 * range_dn)
    return information_bits_per_px(full, range_dn)
