"""How well a change can be detected from further away, and the camera movement this allows."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import sqrt
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from acquisition.files import FIGURES, Provenance
from acquisition.photographs import ReadOptions
from analysis.choices import Criterion, acceptance
from analysis.detectability import (
    STATED,
    AmbiguousCurveError,
    CurveChoice as CurveChoice,
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask as DetectionTask,
    ErrorSources,
    curves_of_images,
    read_curves,
    student_factor,
)
from analysis.errors import AnalysisError
from analysis.evaluation import is_evaluation, read_evaluation
from analysis.pose import (
    QUANTILE,
    FollowupPose,
    PoseLimits,
    PoseQuality,
    ViewingCamera,
    contrast_found_at,
    limits_of_curve,
    pose_quality,
    quality_of_scene,
)
from analysis.reports import plot_pose, write_figure
from calibration.files import read_geometry, read_noise
from calibration.noise import NoiseCalibration
from calibration.psf import PsfCalibration, capture_of
from calibration.registration import DistortedPose, Homography
from simulation.arguments import ArgumentTypeError, accepted, arguments_at_fault, checked, kind_of
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.notebook import Shown
from simulation.pose import DepthSampling, DepthView, SceneDepth
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    NoiseLike,
    PsfLike,
    grey_image,
    listed_images,
    output_path,
    path_of,
)
from standoff.library.psf import calibration_of, camera_psf
from standoff.library.simulation import given_homography, refuse_giant_frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def known_errors(
    psf: PsfLike | None,
    *,
    focus_scatter_px2: float | None = None,
    registration_err_px: float | None = None,
) -> ErrorSources:
    """Return what is known of a camera's errors; its noise is taken to have no error.

    A calibration states its own errors and the focus scatter of its captures; a bare PSF states
    neither. A stated scatter replaces the calibration's. If the calibration has none, the stated
    one also gives the error that the focus of its captures leaves in it.
    """
    stored = None if psf is None else calibration_of(psf)
    variance_err_px2: float | None = None
    psf_focus_share = 0.0
    freedom: float | None = None
    focus_from = None if focus_scatter_px2 is None else STATED
    if stored is not None:
        variance_err_px2 = _variance_err_px2(stored)
        psf_focus_share = _focus_share(stored)
        focus = stored.focus
        if focus_scatter_px2 is None and focus is not None:
            focus_scatter_px2 = focus.scatter_px2
            focus_from = f"{focus.captures} captures of the calibration"
            freedom = focus.freedom or focus.captures - 1
    return ErrorSources(
        psf_variance_err_px2=variance_err_px2,
        psf_focus_share=psf_focus_share,
        focus_scatter_px2=focus_scatter_px2,
        focus_from=focus_from,
        focus_freedom=freedom,
        noise_relative_err=0.0,
        registration_err_px=registration_err_px,
    )


def noise_relative_err(noise: NoiseLike, levels_dn: FloatArray) -> float | None:
    """Return the relative standard error of the noise at levels; None if it is not known."""
    known = read_noise(Path(noise)) if isinstance(noise, str | PathLike) else noise
    return known.relative_err(levels_dn) if isinstance(known, NoiseCalibration) else None


def _variance_err_px2(psf: PsfCalibration) -> float | None:
    """Standard error of the mean of the variances along x and y, as normal quantiles need it."""
    widths = psf.sigma_x_px, psf.sigma_y_px
    if widths[0] is None or widths[1] is None or psf.estimate_covariance is None:
        return None
    slope = np.array(widths, dtype=np.float64)
    among = np.array(psf.estimate_covariance)[:2, :2]
    variance_px4 = max(float(slope @ among @ slope), 0.0)
    if psf.focus is not None:
        # The part that captures share is known with as many degrees of freedom as there are.
        shared_px4 = min(psf.focus.mean_err_px2**2, variance_px4)
        freedom = psf.focus.freedom or psf.focus.captures - 1
        variance_px4 += shared_px4 * (student_factor(freedom) ** 2 - 1)
    return sqrt(variance_px4)


def _focus_share(psf: PsfCalibration) -> float:
    """Standard error of the PSF's variance by the focus of its captures, over their scatter.

    Of two distances the mean variance is ``(z^2 far - near) / (z^2 - 1)``, and focus adds to both.
    """
    if psf.focus is not None:
        return 0.0
    if not psf.pairs:
        return 1 / sqrt(max(len({capture_of(edge) for edge in psf.edges_used}), 1))
    of_photograph: dict[str, float] = {}
    for pair in psf.pairs:
        z2 = pair.zoom**2
        for name, share in ((pair.far, z2 / (z2 - 1)), (pair.near, -1 / (z2 - 1))):
            of_photograph[name] = of_photograph.get(name, 0.0) + share / len(psf.pairs)
    return sqrt(sum(share**2 for share in of_photograph.values()))


@checked
@arguments_at_fault()
def d_prime_curves(
    images: ImageLike | Iterable[ImageLike],
    psf: PsfLike | None = None,
    task: DetectionTask | None = None,
    *,
    reading: ReadOptions | None = None,
) -> DetectabilityCurves:
    """Compute curves of d': how well a change can be detected, at best, from further away.

    Parameters
    ----------
    images
        Photographs of the scene, arrays or files.
    psf
        The camera's PSF; only model ``bicubic`` works without it.
    task
        Zooms, noises, contrasts, models and observers; the defaults of ``DetectionTask`` if None.
        If its ``sources`` state nothing at all, they are taken from the calibration.
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
    """Camera movement that keeps d' at the threshold or above; the reference may be tilted itself.

    ``contrast_found_dn`` is the least contrast whose d' reaches the threshold at the pose
    ``at_zoom`` and ``at_tilt_deg``; None if no such pose was asked for.
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
        """Write the figure of ``plot`` as PNG or SVG, by the ending of the name.

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
        Path of the file to write.
    curves
        As ``d_prime_curves`` returns them. The result of ``measure_curves`` has its own ``write``,
        which also draws figures beside the file.

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
        Curves of ``d_prime_curves`` or one of them, or the path of a curves.json or an
        evaluation.json.
    min_d_prime
        Threshold of d'.
    choice
        Selects one curve, if there are several.
    geometry
        Path of the camera's geometry.json.
    focal_length_px, image_size
        Focal length in px and image size ``(width, height)`` in px, instead of ``geometry``.
    reference_tilt_deg
        Tilt of the reference, towards +x.
    direction_deg
        Direction of the follow-up's tilt, from +x towards +y; by default the worst direction.
    aim_px
        Pixel ``(x, y)`` of the reference that the middle of the follow-up shows, 0 at the centre
        of the first pixel; by default the middle of the reference.
    at_zoom, at_tilt_deg
        Distance ratio and tilt of a pose for which the least detectable contrast is computed as
        well.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture, instead of the curve's.

    Returns
    -------
    AllowedMovement
        Limits of zoom and tilt, and the overlap after a shift. As d' is an upper bound, so are
        the limits.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ArgumentError
        If neither ``geometry`` nor focal length and image size are given, if not exactly one curve
        is selected, or if the threshold is not positive.
    NotDetectableError
        If d' is below the threshold even at equal poses.

    Examples
    --------
    >>> limits = standoff.pose_limits("curves.json", 2, geometry="geometry.json")
    >>> limits.zoom > 1, limits.tilt_deg > 0
    (True, True)
    """
    camera = _viewing_camera(geometry, focal_length_px, image_size)
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
                f"the scores of {found.detector} do not cover other contrasts; evaluate it with "
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
    """Return the one curve that is selected, with the focus scatter if one is stated."""
    accepted("min_d_prime", min_d_prime, float)
    accepted("focus_scatter_px2", focus_scatter_px2, float | None)
    chosen = _chosen_curve(curve, choice)
    if focus_scatter_px2 is not None and chosen.uncertainty is None:
        raise ArgumentError(
            f"{chosen.name}: this curve does not state how it depends on the focus; write it again "
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
    """Read a curves.json, or the curves of d' that an evaluation.json amounts to."""
    return read_evaluation(path).as_d_prime() if is_evaluation(path) else read_curves(path)


def _viewing_camera(
    geometry: FilePath | None, focal_length_px: float | None, image_size: tuple[int, int] | None
) -> ViewingCamera:
    """Return the camera of a geometry.json, or one of this focal length and image size."""
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)  # without slots: keeps results
class JudgedHomography(Shown, ByValue):
    """d' over the frame of a follow-up whose pose is known, and the verdict on that pose.

    Parameters
    ----------
    quality
        The maps and the verdict.
    reference_size, followup_size
        ``(width, height)`` in px.
    hidden
        Of a scene with depth: share of the overlap in which the follow-up sees what the reference
        does not show; no change would be found there. None if the scene was taken as flat.
    notes
        Remarks, one sentence each.
    """

    quality: PoseQuality
    reference_size: tuple[int, int]
    followup_size: tuple[int, int]
    provenance: Provenance
    hidden: float | None = None
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<JudgedHomography: {self.sentence}>"

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a map of d' over the follow-up."""
        return plot_pose(None, self.quality, ax)

    @property
    def is_accepted(self) -> bool:
        """Whether d' reaches the threshold."""
        return self.quality.is_accepted

    @cached_property
    def dprime_median(self) -> float:
        """Median of d' over the overlap."""
        return float(np.nanmedian(self.quality.d_prime))

    @cached_property
    def dprime_quantile(self) -> float:
        """Value of d' that is reached in all but 5 % of the overlap."""
        seen = self.quality.d_prime[np.isfinite(self.quality.d_prime)]
        return float(np.quantile(seen, QUANTILE, method="lower"))

    @cached_property
    def zoom_median(self) -> float:
        """Median of the local zoom over the overlap, along the direction sampled more coarsely."""
        sampling = self.quality.sampling
        return float(np.median(sampling.worst_zoom[sampling.inside]))

    def to_json(self) -> dict[str, Any]:
        """Return the figures as ``standoff limits --homography --json`` prints them.

        They are those of ``standoff pose --json``, with medians, the quantile and the sizes.
        """
        summary = self.quality.summary.model_copy(update={"provenance": self.provenance})
        return {
            **summary.model_dump(mode="json"),
            "dprime_median": self.dprime_median,
            "dprime_quantile": self.dprime_quantile,
            "zoom_median": self.zoom_median,
            "reference_size": list(self.reference_size),
            "followup_size": list(self.followup_size),
            "hidden": self.hidden,
        }

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        quality, summary = self.quality, self.quality.summary
        verdict = acceptance(quality.is_accepted)
        return (
            f"{verdict}: d' {summary.dprime_min:.3g} at least, {self.dprime_median:.3g} in the "
            f"median and {self.dprime_quantile:.3g} or more in 95 % of the overlap, threshold "
            f"{quality.min_d_prime:g} ({quality.criterion}); local zoom {summary.zoom_min:.3f} to "
            f"{summary.zoom_max:.3f}, overlap {100 * summary.overlap:.0f} %"
            + ("" if self.hidden is None else f", of which {100 * self.hidden:.0f} % is hidden")
        )


@checked
def judge_homography(
    homography: ArrayLike | Homography | FilePath,
    curve: CurveLike,
    min_d_prime: float,
    *,
    choice: CurveChoice | None = None,
    size: tuple[int, int] | None = None,
    reference_size: tuple[int, int] | None = None,
    criterion: Criterion = "min",
    focus_scatter_px2: float | None = None,
    depth: SceneDepth | None = None,
) -> JudgedHomography:
    """Judge a pose by its homography, without photographs.

    Parameters
    ----------
    homography
        Maps follow-up pixels ``(x, y, 1)`` to reference pixels: a matrix of shape (3, 3), a
        `Homography`, or the path of an H.json.
    curve
        Curves of ``d_prime_curves`` or one of them, or the path of a curves.json or an
        evaluation.json.
    min_d_prime
        Threshold of d'.
    choice
        Selects one curve, if there are several.
    size
        ``(width, height)`` of the follow-up in px, for a bare matrix; otherwise that of H.json.
    reference_size
        ``(width, height)`` of the reference in px; by default that of the follow-up.
    criterion
        ``min``: d' reaches the threshold everywhere in the overlap; ``quantile``: in all but 5 %.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture, instead of the curve's.
    depth
        Depth of what the reference shows, with the camera's focal length: d' is then that at each
        pixel's own distance, and none of what is hidden. By default the scene is flat.

    Returns
    -------
    JudgedHomography
        d' over the frame, local zoom, overlap and the verdict; d' is an upper bound.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ArgumentError
        If not exactly one curve is selected, or a size is missing.
    AnalysisError
        If the follow-up shows nothing of the reference, or shows the plane's horizon.
    CalibrationError
        If H.json cannot be read.

    Examples
    --------
    >>> standoff.judge_homography("H.json", "curves.json", 2.0).is_accepted
    True
    """
    is_file = isinstance(homography, str | PathLike)
    if size is None and not (is_file or isinstance(homography, Homography)):
        raise ArgumentError("a matrix does not say how large the follow-up is; give size")
    found = given_curve(curve, min_d_prime, choice, focus_scatter_px2)
    files = [one for one in (homography, curve) if isinstance(one, str | PathLike)]
    call = Call("judge_homography", files=files)
    pose = given_homography(homography, size or (1, 1))
    followup_size = size or pose.size
    frame = reference_size or followup_size
    refuse_giant_frame(frame, "reference_size")
    matrix = pose.matrix
    if depth is not None:
        return _judged_with_depth(call, depth, pose, found, (min_d_prime, criterion))
    if pose.distortion_k1 != 0:
        whole = DistortedPose(
            matrix=matrix,
            k1=pose.distortion_k1,
            reference_shape=(frame[1], frame[0]),
            followup_shape=(followup_size[1], followup_size[0]),
        )
        matrix = whole.nearest_homography()
        named = fspath(homography) if isinstance(homography, str | PathLike) else "homography"
        call.note(f"{named}: judged by the homography nearest to its pose and lens distortion")
    quality = pose_quality(matrix, followup_size, frame, found, min_d_prime, criterion)
    if quality.beyond_curve > 0:
        call.note(quality.beyond_curve_sentence)
    return JudgedHomography(
        quality=quality,
        reference_size=frame,
        followup_size=followup_size,
        provenance=call.provenance(),
        notes=call.notes,
    )


def _judged_with_depth(
    call: Call,
    depth: SceneDepth,
    pose: Homography,
    curve: DetectabilityCurve,
    demand: tuple[float, Criterion],
) -> JudgedHomography:
    """Judge a pose before a scene of known depth."""
    try:
        view = DepthView.of_homography(depth, pose.matrix, pose.size, pose.distortion_k1)
    except ArgumentError:
        raise
    except ValueError as error:
        raise AnalysisError(str(error)) from error
    sampling = DepthSampling.of(depth, view)
    quality = quality_of_scene(sampling, curve, *demand)
    if quality.beyond_curve > 0:
        call.note(quality.beyond_curve_sentence)
    rows, cols = depth.shape
    return JudgedHomography(
        quality=quality,
        reference_size=(cols, rows),
        followup_size=pose.size,
        hidden=float(np.mean(sampling.seen.hidden) / np.mean(~sampling.seen.outside)),
        provenance=call.provenance(),
        notes=call.notes,
    )
