"""How a scene looks from further away or from another pose."""

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.photographs import LARGEST_IMAGE_PX, ReadOptions
from calibration.files import read_homography
from calibration.registration import Homography
from simulation import (
    Model,
    PoseOptions,
    SimulatedPose,
    simulate_pose as simulate_pose_of_array,
)
from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    arguments_at_fault,
    checked,
    is_array_like,
    kind_of,
    whole_array,
)
from simulation.choices import DEFAULT_MODEL, PoseModel, PsfShape
from simulation.followup import from_pose, zoomed_out
from simulation.pose import homography_fault
from standoff.library.call import Call
from standoff.library.followup.channels import each_channel
from standoff.library.inputs import FilePath, ImageLike, PsfLike, colour_planes, path_of
from standoff.library.psf import channel_psfs, frame_psf


@checked
@arguments_at_fault()
def zoom_out(
    image: ImageLike,
    zoom: float,
    psf: PsfLike | None = None,
    model: Model = DEFAULT_MODEL,
    *,
    reading: ReadOptions | None = None,
) -> NDArray[np.floating[Any]]:
    """Return the image of the same scene from ``zoom`` times further away.

    Parameters
    ----------
    image
        The photograph, linear in light: an array of shape ``(rows, cols)`` or ``(rows, cols,
        channels)``, or a file.
    zoom
        Ratio of the distances, at least 1.
    psf
        The camera's PSF: a ``GaussianPsf``, a ``MeasuredPsf``, a calibration or the path of a
        psf.json, of which the best is taken. ``matched`` and ``lmmse`` use a PSF that varies over
        the frame if the image is a whole frame. ``bicubic`` needs no PSF. Of a calibration that has
        one for each colour, each channel of an image in colour takes its own.
    model
        ``matched``, ``paper`` (equation 1 of the paper), ``lmmse`` or ``bicubic``.
    reading
        How the image is read; see ``standoff.reading``.

    Returns
    -------
    ndarray of float32, or float64 for float64 input
        In the image's levels; ``floor(N / zoom)`` pixels along each axis, the image centres
        coinciding.

    Raises
    ------
    TypeError
        If the image or the PSF has the wrong type.
    ValueError
        If the zoom is below 1, the image is too small for it, or the model needs a PSF.

    Examples
    --------
    >>> import numpy as np
    >>> near = np.full((120, 160), 700.0)
    >>> far = standoff.zoom_out(near, 2.0, standoff.GaussianPsf(sigma_px=0.8))
    >>> far.shape, round(float(far.mean()), 3)
    ((60, 80), 700.0)
    """
    planes = colour_planes(image, options=reading)
    frame = planes.shape[1], planes.shape[0]
    shape: PsfShape = "gaussian" if model == "paper" else "best"
    camera = None if psf is None else frame_psf(Call("zoom_out"), psf, frame, model, shape)
    own_psfs = None
    if psf is not None and camera is not None and model != "bicubic":
        own_psfs = channel_psfs(Call("zoom_out"), psf, planes, camera)
    if own_psfs is None:
        return zoomed_out(planes, zoom, camera, model).image
    return each_channel(
        planes, own_psfs, lambda plane, own: zoomed_out(plane, zoom, own, model)
    ).image


@checked
@arguments_at_fault()
def simulate_pose(
    image: ImageLike,
    homography: ArrayLike | Homography | FilePath,
    psf: PsfLike,
    size: tuple[int, int] | None = None,
    model: PoseModel = DEFAULT_MODEL,
    *,
    reading: ReadOptions | None = None,
) -> SimulatedPose:
    """Return the image of the same plane from another pose of the same camera.

    Parameters
    ----------
    image
        The photograph, linear in light: an array or a file.
    homography
        Maps follow-up pixels ``(x, y, 1)`` to pixels of the image: shape (3, 3), or the path of
        an H.json.
    psf
        The camera's PSF; channels take their own as in ``zoom_out``.
    size
        ``(width, height)`` of the follow-up; by default that of H.json, or else of the image.
    model
        ``matched`` or ``lmmse``.
    reading
        How the image is read; see ``standoff.reading``.

    Returns
    -------
    SimulatedPose
        The follow-up, and masks of where it would be sharper than the image or is outside it.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If no camera in front of the plane has such a homography.

    Examples
    --------
    >>> far = standoff.simulate_pose("before.tif", "H.json", "psf.json")
    >>> far.image.shape, round(float(far.outside.mean()), 2)
    ((240, 320), 0.29)
    """
    planes = colour_planes(image, options=reading)
    frame = planes.shape[1], planes.shape[0]
    pose = given_homography(homography, size or frame)
    call, options = (
        Call("simulate_pose"),
        PoseOptions(model=model, distortion_k1=pose.distortion_k1),
    )
    known = frame_psf(call, psf, frame if pose.size == frame else None, model)
    matrix, size = pose.matrix, size or pose.size
    own_psfs = channel_psfs(call, psf, planes, known)
    if own_psfs is None:
        return simulate_pose_of_array(planes, matrix, size, known, options)
    made = each_channel(
        planes, own_psfs, lambda plane, own: from_pose(plane, matrix, size, own, options)
    )
    assert made.nearer is not None
    assert made.outside is not None
    return SimulatedPose(image=made.image, nearer=made.nearer, outside=made.outside)


def given_homography(
    homography: ArrayLike | Homography | FilePath, size: tuple[int, int]
) -> Homography:
    """Return a homography as given, or read from its H.json; ``size`` is for a bare matrix.

    Raises
    ------
    ArgumentError
        If it has no inverse, or mirrors the scene.
    HomographyFileError
        If the file cannot be read.
    """
    if isinstance(homography, str | PathLike):
        found = read_homography(path_of(homography, "homography"))
    elif isinstance(homography, Homography):
        found = homography
    elif is_array_like(homography) or isinstance(homography, list | tuple):
        matrix = np.asarray(whole_array(homography, "homography"), dtype=np.float64)
        fault = homography_fault(matrix)
        if fault is not None:
            raise ArgumentError(fault, argument="homography")
        found = Homography(matrix=matrix, size=size)
    else:
        raise ArgumentTypeError(
            "expected a 3 x 3 matrix or the path of an H.json, got " + kind_of(homography),
            argument="homography",
        )
    width, height = found.size
    refuse_giant_frame(found.size, "size")
    fault = homography_fault(found.matrix, ((width - 1) / 2, (height - 1) / 2))
    if fault is not None:
        raise ArgumentError(fault, argument="homography")
    return found


def refuse_giant_frame(size: tuple[int, int], name: str) -> None:
    """Check that a follow-up of ``(width, height)`` can be worked with.

    Raises
    ------
    ArgumentError
        If it has more pixels than photographs that are read.
    """
    width, height = size
    if width * height > LARGEST_IMAGE_PX:
        raise ArgumentError(
            f"at most {LARGEST_IMAGE_PX / 1e6:g} million pixels, got {width} x {height}",
            argument=name,
        )
