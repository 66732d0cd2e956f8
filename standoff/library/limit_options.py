"""Which spots a detection limit is for, what curves of d' predict, and how large a pixel is."""

from dataclasses import dataclass
from math import isfinite
from os import PathLike, fspath
from pathlib import Path
from typing import Self

from analysis.changes import ChangeSummary, LimitCurve
from analysis.choices import SPOT_SIGMA_PX
from analysis.detectability import (
    DetectabilityCurve,
    DetectabilityCurves,
    expected_limits,
    read_curves,
)
from analysis.detection_limits import DetectionLimit
from calibration.files import read_geometry
from calibration.geometry import GeometryCalibration
from calibration.parallax import FrameCamera
from simulation import Model
from simulation.arguments import ArgumentTypeError, check_fields, kind_of
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, FilePath, PsfLike, path_of
from standoff.library.detectability import CurveLike
from standoff.library.psf import calibration_of

_LIMIT_COLOURS = {
    "grey": (1.0, 1.0, 1.0),
    "red": (1.0, 0.0, 0.0),
    "green": (0.0, 1.0, 0.0),
    "blue": (0.0, 0.0, 1.0),
}
"""Changes that have names, in linear levels of red, green and blue."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionLimitOptions:
    """Which spots a detection limit is for, and how large a pixel is.

    Parameters
    ----------
    spot_sigma_px
        Width (sigma) in follow-up pixels of the spots for which the limit is mapped.
    contrast_dn
        Amplitude in DN: the share of the pixels where it would have been found is reported.
    colour
        For photographs in colour, the change of colour that the limit is for: ``grey``, ``red``,
        ``green``, ``blue``, or a text ``R,G,B`` of three numbers, its direction in linear levels.
        Amplitudes are those of the channel that changes most.
    pixel_size_mm
        Side of a follow-up pixel on the scene, for sizes in mm.
    geometry, reference_height_mm
        Instead of ``pixel_size_mm``: the camera's geometry, and the height at which the reference
        was taken, by default the lowest of the geometry. Of a scene with depth, heights in mm
        follow as well. With neither, sizes in mm are those on
        the sensor, if the PSF's calibration states the pixel pitch.
    curves
        Curves of d', one of them of observer ``changes``: the limit that it predicts is compared
        with the one of the two photographs.
    curve_model, curve_noise_dn
        Model and noise that select one of several such curves.

    Raises
    ------
    ArgumentError
        If a size is not above 0, or two arguments contradict one another.

    Examples
    --------
    >>> spots = standoff.DetectionLimitOptions(spot_sigma_px=2.0, pixel_size_mm=0.5)
    >>> found = standoff.find_changes("before.tif", "after.tif", "psf.json", limit=spots)
    >>> limit = found.summary.detection_limit
    >>> limit.map_spot_sigma_px, 0 < limit.mapped.p95_dn < 900
    (2.0, True)
    """

    spot_sigma_px: float = SPOT_SIGMA_PX
    contrast_dn: float | None = None
    colour: str = "grey"
    pixel_size_mm: float | None = None
    geometry: GeometryCalibration | FilePath | None = None
    reference_height_mm: float | None = None
    curves: CurveLike | None = None
    curve_model: Model | None = None
    curve_noise_dn: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        limit_rgb(self.colour)
        if self.pixel_size_mm is not None and self.geometry is not None:
            raise ArgumentError(
                "the geometry states it already; give one of them", argument="pixel_size_mm"
            )
        if self.reference_height_mm is not None and self.geometry is None:
            raise ArgumentError(
                "needs a geometry, for the scale at that height", argument="reference_height_mm"
            )


def limit_rgb(colour: str) -> tuple[float, float, float]:
    """Return the direction of a change in red, green and blue, its largest component 1."""
    known = _LIMIT_COLOURS.get(colour)
    if known is not None:
        return known
    try:
        red, green, blue = (float(part) for part in colour.split(","))
    except ValueError:
        red = green = blue = 0.0
    largest = max(map(abs, (red, green, blue)))
    if not largest > 0 or not isfinite(red + green + blue):
        raise ArgumentError(
            f"expected {', '.join(_LIMIT_COLOURS)} or three numbers such as 1,-0.5,0, got "
            f"{colour!r}",
            argument="colour",
        )
    return red / largest, green / largest, blue / largest


def limit_files(options: DetectionLimitOptions | None) -> tuple[object, ...]:
    """Return the geometry and the curves of the options, for the provenance."""
    return () if options is None else (options.geometry, options.curves)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedCamera:
    """A camera of known geometry, and where it took the reference.

    ``size`` is that of its frames, ``(width, height)``; None in older files. ``focal_length_px`` is
    None if it was not determined, ``principal_px`` counts from the middle of the frame.
    ``reference_mm`` is the distance of the reference's entrance pupil from the plane.
    """

    size: tuple[int, int] | None
    focal_length_px: float | None
    principal_px: tuple[float, float]
    reference_mm: float

    @classmethod
    def of(cls, geometry: GeometryCalibration, height_mm: float) -> Self:
        """Take it from a geometry, at a height of the stage."""
        width, height = geometry.width_px, geometry.height_px
        return cls(
            size=None if width is None or height is None else (width, height),
            focal_length_px=geometry.focal_length_px,
            principal_px=(geometry.principal_x_px or 0.0, geometry.principal_y_px or 0.0),
            reference_mm=height_mm + geometry.pupil_offset_mm,
        )

    def camera(self, shapes: tuple[tuple[int, int], tuple[int, int]]) -> FrameCamera:
        """Return the camera of two photographs of these shapes ``(rows, cols)``.

        Raises
        ------
        ApplicationError
            If they are not whole frames of it, or its focal length is not known.
        """
        if self.focal_length_px is None:
            raise ApplicationError("the geometry has no focal length")
        rows, cols = shapes[0]
        for high, wide in shapes:
            if (wide, high) != (self.size or (cols, rows)):
                own_wide, own_high = self.size or (cols, rows)
                raise ApplicationError(
                    f"the geometry is of frames of {own_wide} x {own_high} px, but a photograph "
                    f"has {wide} x {high}"
                )
        x, y = self.principal_px
        return FrameCamera(
            focal_length_px=self.focal_length_px,
            principal_px=((cols - 1) / 2 + x, (rows - 1) / 2 + y),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneScale:
    """Side of a pixel in mm; None where nothing states it.

    ``followup_mm`` and ``reference_mm`` are sides of their pixels on the scene, ``sensor_mm`` is
    the side on the sensor. ``placed`` is the camera whose geometry states it.
    """

    followup_mm: float | None = None
    reference_mm: float | None = None
    sensor_mm: float | None = None
    placed: PlacedCamera | None = None

    def in_mm(self, limit: DetectionLimit, zoom: float) -> DetectionLimit:
        """Give a limit its sizes in mm; ``zoom`` is reference pixels per follow-up pixel."""
        size_mm = self.followup_mm
        if size_mm is None and self.reference_mm is not None:
            size_mm = self.reference_mm * zoom
        plane = "scene" if size_mm is not None else "sensor"
        if size_mm is None:
            size_mm = self.sensor_mm
        if size_mm is None:
            return limit
        spots = tuple(
            spot.model_copy(update={"spot_sigma_mm": spot.spot_sigma_px * size_mm})
            for spot in limit.spots
        )
        update = {"spots": spots, "pixel_size_mm": size_mm, "pixel_size_on": plane}
        return limit.model_copy(update=update)


def scene_scale(call: Call, options: DetectionLimitOptions, psf: PsfLike | None) -> SceneScale:
    """Return how large pixels are, by what states it most directly."""
    if options.pixel_size_mm is not None:
        return SceneScale(followup_mm=options.pixel_size_mm)
    if options.geometry is not None:
        return _scale_of(call, options.geometry, options.reference_height_mm)
    return SceneScale(sensor_mm=_pitch_mm(psf))


def _scale_of(
    call: Call, geometry: GeometryCalibration | FilePath, height_mm: float | None
) -> SceneScale:
    """How large a reference's pixel is, and where its camera stood."""
    if isinstance(geometry, GeometryCalibration):
        found, name = geometry, "the geometry"
    else:
        path = path_of(geometry, "geometry")
        found, name = read_geometry(path), str(path)
    at_mm = height_mm
    if at_mm is None:
        at_mm = min(found.heights_mm)
        if len(found.heights_mm) > 1:
            call.note(
                f"sizes in mm are those of a reference at {at_mm:g} mm, the lowest height of {name}"
            )
    scale = found.scale_at(at_mm)
    if scale is None:
        raise ApplicationError(
            f"{name} has no scale at {at_mm:g} mm; give the height of the reference, between "
            f"{min(found.heights_mm):g} and {max(found.heights_mm):g} mm, or the size of a pixel"
        )
    return SceneScale(reference_mm=1 / scale, placed=PlacedCamera.of(found, at_mm))


def _pitch_mm(psf: PsfLike | None) -> float | None:
    stored = None if psf is None else calibration_of(psf)
    pitch_um = None if stored is None else stored.pixel_pitch_um
    return None if pitch_um is None else pitch_um / 1000


def expected_limit(options: DetectionLimitOptions) -> LimitCurve | None:
    """Return what the curves of observer ``changes`` predict; None if there are no curves."""
    if options.curves is None:
        return None
    curves, name = options.curves, "curves"
    if isinstance(curves, str | PathLike):
        name, curves = fspath(curves), read_curves(Path(curves))
    if isinstance(curves, DetectabilityCurve):
        curves = DetectabilityCurves(curves=[curves])
    if not isinstance(curves, DetectabilityCurves):
        raise ArgumentTypeError(
            f"expected curves of d' or the path of a curves.json, got {kind_of(curves)}",
            argument="curves",
        )
    return expected_limits(_chosen(curves, options, name))


def note_on_prediction(
    call: Call, options: DetectionLimitOptions | None, found: ChangeSummary
) -> None:
    """Say so where the curves predict nothing for the pair's zoom."""
    limit = found.detection_limit
    asked = options is not None and options.curves is not None
    if asked and limit is not None and limit.predicted is None:
        call.note(
            f"the curves do not cover zoom {found.zoom:.3f}; no limit was predicted for this pair"
        )


def _chosen(
    curves: DetectabilityCurves, options: DetectionLimitOptions, name: str
) -> DetectabilityCurve:
    """The one that predicts comparisons; the limit does not depend on the curve's contrast."""
    fitting = {
        (curve.model, curve.noise_dn): curve
        for curve in curves.curves
        if curve.observer == "changes"
        and curve.seen_sigma_px is not None
        and options.curve_model in (None, curve.model)
        and (options.curve_noise_dn is None or _is_same(options.curve_noise_dn, curve.noise_dn))
    }
    if len(fitting) == 1:
        return next(iter(fitting.values()))
    if not fitting:
        raise ArgumentError(
            f'{name}: no such curve for the observer "changes"; make one with standoff '
            "detectability --observer changes, for a Gaussian change"
        )
    models, noises = (sorted({key[k] for key in fitting}, key=str) for k in (0, 1))
    told = [
        f"{option} ({', '.join(f'{value}' for value in values)})"
        for option, values in (("--curve-model", models), ("--curve-noise", noises))
        if len(values) > 1
    ]
    raise ArgumentError(
        f'{name}: {len(fitting)} curves for the observer "changes"; choose one with '
        f"{' and '.join(told)}"
    )


def _is_same(one: float, other: float) -> bool:
    return abs(one - other) <= 1e-6 * max(abs(other), 1.0)
