"""How well a change can be detected from further away, and the camera movement this allows."""

from collections.abc import Iterable
from os import PathLike
from pathlib import Path

from analysis.detectability import (
    CurveChoice,
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask as DetectionTask,
    d_prime_curves as curves_of_images,
    read_curves,
)
from analysis.pose import PoseLimits, ViewingCamera, pose_limits as limits_of_curve
from calibration.files import read_geometry
from standoff.library.inputs import (
    FilePath,
    ImageLike,
    PsfLike,
    grey_image,
    listed_images,
    path_of,
    whole_frame_psf,
)


def d_prime_curves(
    images: ImageLike | Iterable[ImageLike],
    psf: PsfLike | None = None,
    task: DetectionTask | None = None,
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
    """
    scenes = [
        grey_image(image, f"images[{number}]") for number, image in enumerate(listed_images(images))
    ]
    return curves_of_images(scenes, None if psf is None else whole_frame_psf(psf), task)


def pose_limits(
    curve: DetectabilityCurve | DetectabilityCurves | FilePath,
    min_d_prime: float,
    *,
    geometry: FilePath | None = None,
    focal_length_px: float | None = None,
    image_size: tuple[int, int] | None = None,
) -> PoseLimits:
    """Return the distance ratio and the tilt that keep d' at a threshold or above.

    Parameters
    ----------
    curve
        One of the curves of ``d_prime_curves``, or a curves.json that holds only one.
    min_d_prime
        The threshold.
    geometry
        geometry.json of the camera.
    focal_length_px, image_size
        Focal length and ``(width, height)`` of the camera, instead of ``geometry``.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If the camera is unknown, or several curves are given.
    NotDetectableError
        If d' is below the threshold even at equal poses.
    """
    camera = _camera(geometry, focal_length_px, image_size)
    return limits_of_curve(_one_curve(curve), min_d_prime, camera)


def _one_curve(curve: DetectabilityCurve | DetectabilityCurves | FilePath) -> DetectabilityCurve:
    if isinstance(curve, DetectabilityCurve):
        return curve
    if isinstance(curve, str | PathLike):
        curve = read_curves(Path(curve))
    if isinstance(curve, DetectabilityCurves):
        return curve.chosen(CurveChoice())
    raise TypeError(
        f"curve: expected a curve of d' or the path of a curves.json, got {type(curve).__name__}"
    )


def _camera(
    geometry: FilePath | None, focal_length_px: float | None, image_size: tuple[int, int] | None
) -> ViewingCamera:
    if geometry is not None:
        stored = read_geometry(path_of(geometry, "geometry"))
        if stored.width_px is not None and stored.height_px is not None:
            focal_length_px = stored.focal_length_px
            image_size = stored.width_px, stored.height_px
    if focal_length_px is None or image_size is None:
        raise ValueError(
            "give focal_length_px and image_size"
            if geometry is None
            else f"{geometry} does not give the focal length and the frame size; "
            "give focal_length_px and image_size"
        )
    width_px, height_px = image_size
    return ViewingCamera(focal_length_px=focal_length_px, width_px=width_px, height_px=height_px)
