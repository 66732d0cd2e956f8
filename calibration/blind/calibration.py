"""The PSF from photographs of ordinary scenes: from one image, or from two distances."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from calibration.blind.single_image import fit_sharpest_widths, is_clear
from calibration.blind.two_distance import PairPsf, combined, pair_psf
from calibration.choices import CalibrationMethod
from calibration.edges import EdgeImage, EdgeMeasurement, Region, measure_edges
from calibration.errors import NoEdgeError, PairError, RegistrationError
from calibration.psf import PairWidths, PsfCalibration, estimates_of_covariance
from calibration.registration import register
from simulation.arrays import FloatArray
from simulation.resampling import ZOOM_MIN

_PIXEL_VARIANCE_PX2 = 1.0 / 12.0
_MOST_SATURATED = 0.005


def calibrate_from_scene(
    sources: Iterable[EdgeImage],
    *,
    region: Callable[[EdgeImage], Region | None] = lambda _: None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF from the edges in ordinary photographs (method single-image).

    Accurate to some 10 to 15 % if the scene's edges are sharper than a pixel; softer scenes give
    too wide a PSF. Parameters are those of ``calibrate_psf``.

    Raises
    ------
    NoEdgeError
        If too few edges are clear enough.
    """
    edges: list[EdgeMeasurement] = []
    names: list[str] = []
    for done, source in enumerate(sources, start=1):
        names.append(source.name)
        # The texture beside an edge in a scene acts as its noise, whatever the camera's is.
        edges.extend(measure_edges(replace(source, noise=None), region(source)))
        progress(done)
    clear = [edge for edge in edges if "saturated" not in edge.flags and is_clear(edge)]
    try:
        widths = fit_sharpest_widths(
            np.array([edge.angle_deg for edge in clear]),
            np.array([edge.sigma_px for edge in clear]),
            np.array([edge.sigma_err_px for edge in clear]),
        )
    except ValueError as error:
        where = names[0] if len(names) == 1 else f"{len(names)} images"
        raise NoEdgeError(
            f"{where}: {error}; use a scene with sharp edges, or more images", found=len(clear)
        ) from error
    return _calibration(
        widths.covariance_px2,
        widths.covariance_err_px2,
        "single-image",
        edges=tuple(edges),
        softness_px2=widths.softness_px2,
    )


def calibrate_from_distances(
    series: Sequence[Sequence[EdgeImage]],
    *,
    zoom: float | None = None,
    region: Callable[[EdgeImage], Region | None] = lambda _: None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF from scenes photographed at two or more distances (method two-distance).

    Parameters
    ----------
    series
        Photographs of each scene, the nearest first; each of the others is compared with it.
    zoom
        Ratio of the distances, if matched features do not suffice to align the photographs; None
        to align them by their features.
    region
        Returns the part of the nearest photograph to use, None for all of it.
    progress
        Called with the number of pairs done.

    Raises
    ------
    PairError
        If no pair can be aligned and determines the PSF; the error of the first pair.
    ValueError
        If a region is not inside its photograph.
    """
    found: list[tuple[EdgeImage, EdgeImage, PairPsf]] = []
    failures: list[tuple[EdgeImage, EdgeImage, PairError]] = []
    done = 0
    for near, *further in series:
        for far in further:
            try:
                found.append((near, far, _pair(near, far, zoom, region(near))))
            except PairError as error:
                failures.append((near, far, error))
            done += 1
            progress(done)
    if not found:
        if not failures:
            raise PairError(
                "no scene has two photographs; photograph a scene from two distances",
                reason="no_pair",
            )
        near, far, fault = failures[0]
        raise PairError(
            f"{near.name} and {far.name}: {fault}",
            reason=fault.reason,
            photographs=fault.photographs or (near.name, far.name),
        ) from fault
    elements, errors = combined([pair for _, _, pair in found])
    xx, xy, yy = elements
    return _calibration(
        np.array([[xx, xy], [xy, yy]]),
        errors,
        "two-distance",
        pairs=tuple(_widths(near.name, far.name, pair) for near, far, pair in found),
    )


def _pair(near: EdgeImage, far: EdgeImage, zoom: float | None, region: Region | None) -> PairPsf:
    for source in (near, far):
        if source.saturation_dn is not None:
            share = float(np.mean(source.image_dn >= 0.995 * source.saturation_dn))
            if share > _MOST_SATURATED:
                raise PairError(
                    f"{source.name}: {100 * share:.1f} % of the pixels are saturated; "
                    "shorten the exposure",
                    reason="saturated",
                    photographs=(source.name,),
                )
    if zoom is None:
        try:
            pose = register(near.image_dn, far.image_dn).pose
        except RegistrationError as error:
            raise PairError(str(error), reason="not_aligned") from error
        if pose.zoom < ZOOM_MIN:
            raise PairError(
                f"the first photograph is the further one (zoom {pose.zoom:.3f}); give the nearer "
                "photograph first",
                reason="not_aligned",
            )
        matrix = pose.nearest_homography()
    else:
        matrix = _centred_zoom(zoom, near.image_dn.shape, far.image_dn.shape)
    image = near.image_dn
    if region is not None:
        near.refuse_beyond_frame(region)
        bottom, right = region.y_px + region.height_px, region.x_px + region.width_px
        image = image[region.y_px : bottom, region.x_px : right]
        matrix = np.array([[1, 0, -region.x_px], [0, 1, -region.y_px], [0, 0, 1]]) @ matrix
    noise_dn2 = 0.0 if near.noise is None else float(near.noise.variance_dn2(image).mean())
    return pair_psf(image, far.image_dn, matrix, near_noise_dn2=noise_dn2)


def _centred_zoom(zoom: float, near: tuple[int, ...], far: tuple[int, ...]) -> FloatArray:
    x = (near[1] - 1) / 2 - zoom * (far[1] - 1) / 2
    y = (near[0] - 1) / 2 - zoom * (far[0] - 1) / 2
    return np.array([[zoom, 0.0, x], [0.0, zoom, y], [0.0, 0.0, 1.0]])


def _widths(near: str, far: str, pair: PairPsf) -> PairWidths:
    sigma_x, sigma_y = np.sqrt(np.diag(pair.covariance_px2)).tolist()
    err_xx, _, err_yy = np.sqrt(np.diag(pair.covariance_err_px2)).tolist()
    return PairWidths(
        near=near,
        far=far,
        zoom=pair.zoom,
        sigma_x_px=sigma_x,
        sigma_x_err_px=err_xx / (2 * sigma_x),
        sigma_y_px=sigma_y,
        sigma_y_err_px=err_yy / (2 * sigma_y),
    )


def _calibration(
    covariance_px2: FloatArray,
    errors: FloatArray,
    method: CalibrationMethod,
    *,
    edges: tuple[EdgeMeasurement, ...] = (),
    pairs: tuple[PairWidths, ...] = (),
    softness_px2: float | None = None,
) -> PsfCalibration:
    optical_px2 = covariance_px2 - _PIXEL_VARIANCE_PX2 * np.eye(2)
    is_resolved = bool(np.all(np.linalg.eigvalsh(optical_px2) > 0))
    return PsfCalibration.of(
        estimates_of_covariance(covariance_px2, errors),
        estimates_of_covariance(optical_px2, errors) if is_resolved else None,
        method=method,
        edges=edges,
        pairs=pairs,
        softness_px2=softness_px2,
    )
