"""How well a change can be detected from further away, and the camera movement this allows."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeAlias

from acquisition.photographs import ReadOptions
from analysis.detectability import (
    AmbiguousCurveError,
    CurveChoice as CurveChoice,
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask as DetectionTask,
    ErrorSources,
    d_prime_curves as curves_of_images,
    read_curves,
)
from analysis.evaluation import is_evaluation, read_evaluation
from analysis.pose import (
    FollowupPose,
    PoseLimits,
    ViewingCamera,
    contrast_found_at,
    pose_limits as limits_of_curve,
)
from calibration.files import read_geometry
from simulation.arguments import ArgumentTypeError, accepted, arguments_at_fault, checked, kind_of
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call
from standoff.library.detectability.error_sources import known_errors
from standoff.library.files import FIGURES, write_figure
from standoff.library.inputs import (
    FilePath,
    ImageLike,
    PsfLike,
    grey_image,
    listed_images,
    output_path,
    path_of,
)
from standoff.library.psf import camera_psf


@checked
@arguments_at_fault()
def d_prime_curves(
    images: ImageLike | Iterable[ImageLike],
    psf: PsfLike | None = None,
    task: DetectionTask | None = None,
    *,
    reading: ReadOptions | None = None,
) -> DetectabilityCurves:
    """Measure how well a change can be detected, at best, from different distances.

    Parameters
    ----------
    images
        Photographs of the scene, arrays or files.
    psf
        The camera's PSF; only model ``bicubic`` works without it.
    task
        Zooms, noises, contrasts, models and observers; the defaults of ``DetectionTask`` if None.
        Where its ``sources`` say nothing, they are what the calibration says of its errors.
    reading
        How the photographs are read; see ``standoff.reading``.

    Returns
    -------
    DetectabilityCurves
        A curve of d' against the zoom-out for every model, observer, noise and contrast: the
        content of a curves.json.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If an image is too small, or a model needs a PSF.

    Examples
    --------
    >>> task = standoff.DetectionTask(zooms=(1.0, 1.5), models=("matched",), noises_dn=(12.0,))
    >>> curves = standoff.d_prime_curves(["before.tif"], "psf.json", task)
    >>> [curve.observer for curve in curves.curves]
    ['npw', 'hotelling', 'cho']
    """
    known = known_errors(psf)
    task = task or DetectionTask()
    if task.sources == ErrorSources():
        task = replace(task, sources=known)
    scenes = [
        grey_image(image, f"images[{number}]", reading)
        for number, image in enumerate(listed_images(images))
    ]
    return curves_of_images(
        scenes, None if psf is None else camera_psf(Call("d_prime_curves"), psf), task
    )


CurveLike: TypeAlias = DetectabilityCurve | DetectabilityCurves | FilePath
"""A curve of d', several, or the path of a curves.json."""


@dataclass(frozen=True, kw_only=True, repr=False)
class AllowedMovement(PoseLimits):
    """Movement that keeps d' at the threshold, of a reference that may be tilted itself.

    ``contrast_found_dn`` is the least contrast whose d' reaches the threshold at ``at_zoom`` and
    ``at_tilt_deg``, if they were asked for.
    """

    reference_tilt_deg: float = 0.0
    direction_deg: float | None = None
    at_zoom: float | None = None
    at_tilt_deg: float | None = None
    contrast_found_dn: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the limits as ``standoff limits --json`` prints them."""
        return {
            "curve": self.curve.choice.model_dump(),
            "min_dprime": self.min_d_prime,
            "reference_tilt_deg": self.reference_tilt_deg,
            "tilt_direction_deg": self.direction_deg,
            "is_upper_bound": True,
            "aim_px": self.aim_px,
            "aimed_overlap": self.aimed_overlap,
            **{name: getattr(self, name) for name in _LIMITS},
            "at_zoom": self.at_zoom,
            "at_tilt_deg": self.at_tilt_deg,
            "contrast_found_dn": self.contrast_found_dn,
        }

    def write_plot(self, path: FilePath) -> None:
        """Write the figure of ``plot`` as PNG or SVG, as the name says.

        Raises
        ------
        ApplicationError
            If the file cannot be written.
        """
        from analysis.reports import plot_limits

        write_figure(output_path(path, "path", FIGURES), plot_limits(self))


_LIMITS = (
    "zoom",
    "zoom_interval_95",
    "is_zoom_beyond_curve",
    "tilt_deg",
    "tilt_interval_95_deg",
    "zoom_by_tilt",
    "overlap_by_shift",
)


@checked
def write_curves(path: FilePath, curves: DetectabilityCurves) -> None:
    """Write a curves.json, whole or not at all.

    Parameters
    ----------
    path
        Of the file.
    curves
        As ``d_prime_curves`` returns them; those of ``measure_curves`` have a ``write`` that draws
        figures beside the file.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.

    Examples
    --------
    >>> task = standoff.DetectionTask(zooms=(1.0, 1.5), models=("matched",), noises_dn=(12.0,))
    >>> curves = standoff.d_prime_curves(["before.tif"], "psf.json", task)
    >>> standoff.write_curves("near.json", curves)
    >>> standoff.read_curves("near.json") == curves
    True
    """
    curves.write(path)


@checked
def pose_limits(
    curve: CurveLike,
    min_d_prime: float,
    *,
    choice: CurveChoice | None = None,
    geometry: FilePath | None = None,
    focal_length_px: float | None = None,
    image_size: tuple[int, int] | None = None,
    reference_tilt_deg: float = 0.0,
    direction_deg: float | None = None,
    aim_px: tuple[float, float] | None = None,
    at_zoom: float | None = None,
    at_tilt_deg: float = 0.0,
    focus_scatter_px2: float | None = None,
) -> AllowedMovement:
    """Return the distance ratio, the tilt and the shift that keep d' at a threshold or above.

    Parameters
    ----------
    curve
        One of the curves of ``d_prime_curves``, or a curves.json.
    min_d_prime
        The threshold.
    choice
        Which curve, if there are several.
    geometry
        geometry.json of the camera.
    focal_length_px, image_size
        Focal length and ``(width, height)`` of the camera, instead of ``geometry``.
    reference_tilt_deg
        Of the reference, towards +x.
    direction_deg
        Of the follow-up's tilt, from +x towards +y; the worst by default.
    aim_px
        Pixel ``(x, y)`` of the reference that the middle of the follow-up shows, 0 at the centre
        of the first one; by default the middle of the reference.
    at_zoom, at_tilt_deg
        Pose at which the least detectable contrast is wanted as well.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture, instead of the curve's.

    Returns
    -------
    AllowedMovement
        Zoom, tilt and overlap; d' is an upper bound, and so are they.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ArgumentError
        If the camera is unknown, several curves are meant, or the threshold is not positive.
    NotDetectableError
        If d' is below the threshold even at equal poses.

    Examples
    --------
    >>> limits = standoff.pose_limits("curves.json", 2, geometry="geometry.json")
    >>> limits.zoom > 1, limits.tilt_deg > 0
    (True, True)
    """
    camera = viewing_camera(geometry, focal_length_px, image_size)
    found = given_curve(curve, min_d_prime, choice, focus_scatter_px2)
    if aim_px is not None:
        try:
            camera.aimed_at(aim_px, reference_tilt_deg)
        except ValueError as error:
            raise ArgumentError(str(error)) from error
    limits = limits_of_curve(found, min_d_prime, camera, reference_tilt_deg, direction_deg, aim_px)
    contrast_dn = None
    if at_zoom is not None:
        if found.observer == "detector":
            raise ArgumentError(
                f"the scores of {found.detector} say nothing of other contrasts; evaluate it with "
                "--contrast"
            )
        pose = FollowupPose(
            zoom=at_zoom,
            tilt_deg=at_tilt_deg,
            reference_tilt_deg=reference_tilt_deg,
            direction_deg=direction_deg,
            aim_px=aim_px,
        )
        contrast_dn = contrast_found_at(found, min_d_prime, camera, pose)
    return AllowedMovement(
        **{one.name: getattr(limits, one.name) for one in fields(limits)},
        reference_tilt_deg=reference_tilt_deg,
        direction_deg=direction_deg,
        at_zoom=at_zoom,
        at_tilt_deg=None if at_zoom is None else at_tilt_deg,
        contrast_found_dn=contrast_dn,
    )


def given_curve(
    curve: CurveLike,
    min_d_prime: float,
    choice: CurveChoice | None = None,
    focus_scatter_px2: float | None = None,
) -> DetectabilityCurve:
    """Return the one curve that is meant, with a scatter of the focus if one is stated.

    Raises
    ------
    TypeError
        If it is neither a curve nor a path.
    ArgumentError
        If none or several match, the threshold is not positive, or the scatter is negative or of a
        curve of before, which does not know what it does.
    ResultsFileError
        If the file cannot be read.
    """
    accepted("min_d_prime", min_d_prime, float)
    accepted("focus_scatter_px2", focus_scatter_px2, float | None)
    chosen = _chosen_curve(curve, choice)
    if focus_scatter_px2 is not None and chosen.uncertainty is None:
        raise ArgumentError(
            f"{chosen.name}: this curve does not know what the focus does to it; write it anew "
            "with standoff detectability"
        )
    return chosen.knowing(focus_scatter_px2=focus_scatter_px2)


def _chosen_curve(curve: CurveLike, choice: CurveChoice | None) -> DetectabilityCurve:
    if isinstance(curve, DetectabilityCurve):
        return curve
    name = "curves"
    if isinstance(curve, str | PathLike):
        name, curve = fspath(curve), read_any_curves(Path(curve))
    if not isinstance(curve, DetectabilityCurves):
        raise ArgumentTypeError(
            f"expected a curve of d' or the path of a curves.json, got {kind_of(curve)}",
            argument="curve",
        )
    try:
        return curve.chosen(choice or CurveChoice())
    except AmbiguousCurveError as error:
        raise ArgumentError(f"{name}: {error}") from error


def read_any_curves(path: Path) -> DetectabilityCurves:
    """Read a curves.json, or the curves of d' that an evaluation.json amounts to.

    Raises
    ------
    ResultsFileError
        If it is neither.
    """
    return read_evaluation(path).as_d_prime() if is_evaluation(path) else read_curves(path)


def viewing_camera(
    geometry: FilePath | None, focal_length_px: float | None, image_size: tuple[int, int] | None
) -> ViewingCamera:
    """Return the camera of a geometry.json, or that of these figures.

    Raises
    ------
    ArgumentError
        If it is not known, or cannot be.
    """
    if geometry is not None:
        stored = read_geometry(path_of(geometry, "geometry"))
        if stored.width_px is not None and stored.height_px is not None:
            focal_length_px = stored.focal_length_px
            image_size = stored.width_px, stored.height_px
    if focal_length_px is None or image_size is None:
        if geometry is not None:
            raise ApplicationError(
                f"{geometry}: the focal length or the frame is not determined; give "
                "--focal-length-px and --image-size"
            )
        raise ArgumentError("give focal_length_px and image_size, or geometry")
    width_px, height_px = image_size
    try:
        return ViewingCamera(
            focal_length_px=focal_length_px, width_px=width_px, height_px=height_px
        )
    except ValueError as error:
        if geometry is not None:
            raise ApplicationError(f"{geometry}: {error}") from error
        raise ArgumentError(
            f"{focal_length_px:g} px and frames of {width_px} x {height_px} px: {error}",
            argument="focal_length_px",
        ) from error
