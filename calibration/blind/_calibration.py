"""The PSF from photographs without an edge target: of one scene, or of one at two distances.

The PSF from the edges in one photograph of an ordinary scene. Luxen and Förstner, Characterizing
image quality: blind estimation of the point spread function from a single image, PCV 2002: wherever
the scene has a sharp edge, the width of its image is that of the PSF across it, and widths in many
directions give the covariance. The edges of an ordinary scene are not all sharp. Where the paper
takes a robust mean, the softness of the scene is modelled here: an edge's variance is ``n' Sigma
n`` plus an exponentially distributed softness plus the error of its fit (an exponentially modified
Gaussian), and some edges are outliers; maximum likelihood finds Sigma and the mean softness
together.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import exp, log, pi, sqrt, tanh

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize
from scipy.special import erfcx, log_ndtr

from calibration.blind._lens_estimate import LensEstimate
from calibration.blind._lens_prior import GAUSSIAN_PARAMETERS
from calibration.blind.two_distance import (
    LEAST_ZOOM,
    ClippedPixels,
    NearAndFar,
    PairPsf,
    combined,
    pair_psf,
)
from calibration.choices import CalibrationMethod
from calibration.edges import EdgeImage, EdgeMeasurement, JpegCompression, Region, edges_of_image
from calibration.errors import NoEdgeError, PairError, RegistrationError
from calibration.psf import (
    PairWidths,
    PsfCalibration,
    SampledLens,
    Transfer2d,
    estimates_of_covariance,
)
from calibration.registration import register_images, zoom_at_centre
from simulation.arrays import BoolArray, FloatArray

FEWEST_EDGES = 12
"""Edges needed for the three elements of Sigma and the softness, with a few to spare."""

_OUTLIERS = 0.05  # fraction of edges that are not steps at all
_REACH = 3.0  # of the search, in logarithms of widths and their ratio
_OUTLIER_SPREAD_PX2 = 1.0
_LEAST_ERR_PX2 = 0.01  # of an edge's variance: its own error does not include texture beside it
_STEP = 1e-3
_RATIO_SPREAD = 0.15  # lenses blur x and y about equally: prior of log(sigma_x / sigma_y)
_TILT_SPREAD = 0.2  # prior of atanh(rho)
_WIDEST_ERR = 0.5  # relative to the width: edges with larger errors are ignored
_CLEAREST_SNR = 9.0


def is_clear(edge: EdgeMeasurement) -> bool:
    """Whether an edge in a scene stands out from the scatter on either side of it."""
    return edge.snr is None or edge.snr >= _CLEAREST_SNR


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _SharpestWidths:
    """Covariance of the PSF, px^2, on which the sharpest edges agree.

    ``covariance_err_px2``, shape (3, 3), is of the elements (xx, xy, yy), ``softness_px2`` the mean
    variance that the scene adds.
    """

    covariance_px2: FloatArray
    covariance_err_px2: FloatArray
    softness_px2: float
    edges_used: int


def _fit_sharpest_widths(
    angles_deg: FloatArray, sigma_px: FloatArray, sigma_err_px: FloatArray
) -> _SharpestWidths:
    """Fit the PSF to widths of edges, some of which are soft in the scene itself.

    At least 12 edges need an error below half of their width; angles are from +x, y down.
    """
    sure = sigma_err_px < _WIDEST_ERR * sigma_px
    if np.count_nonzero(sure) < FEWEST_EDGES:
        raise ValueError(
            f"only {np.count_nonzero(sure)} edges are sharp and clear enough, "
            f"but {FEWEST_EDGES} are needed"
        )
    normal = np.deg2rad(angles_deg[sure] + 90.0)
    nx, ny = np.cos(normal), np.sin(normal)
    variance = sigma_px[sure] ** 2
    err = np.hypot(2 * sigma_px[sure] * sigma_err_px[sure], _LEAST_ERR_PX2)

    def cost(parameters: FloatArray) -> float:
        xx, xy, yy = _covariance(parameters)
        expected = nx**2 * xx + 2 * nx * ny * xy + ny**2 * yy
        likely = _log_modified_gaussian(variance - expected, err, float(np.exp(parameters[3])))
        spread = np.hypot(err, _OUTLIER_SPREAD_PX2)
        outlying = -0.5 * ((variance - expected) / spread) ** 2 - np.log(sqrt(2 * pi) * spread)
        joint = np.logaddexp(log(1 - _OUTLIERS) + likely, log(_OUTLIERS) + outlying)
        unequal, tilted = parameters[1] / _RATIO_SPREAD, parameters[2] / _TILT_SPREAD
        return -float(joint.sum()) + 0.5 * float(unequal**2 + tilted**2)

    width = sqrt(float(np.quantile(variance, 0.25)))
    middle = log(width)
    bounds = [
        (middle - _REACH, middle + _REACH),
        (-_REACH, _REACH),
        (-_REACH, _REACH),
        (2 * middle - 3 * _REACH, 2 * middle + _REACH),
    ]
    best = None
    for start_width, softness in ((width, 0.3), (0.8 * width, 1.0), (1.2 * width, 0.1)):
        start = np.array([log(start_width), 0.0, 0.0, log(softness * width**2)])
        found = minimize(
            cost, start, method="Nelder-Mead", bounds=bounds, options={"maxiter": 2000}
        )
        if best is None or found.fun < best.fun:
            best = found
    assert best is not None
    xx, xy, yy = _covariance(best.x)
    hessian = _hessian(cost, best.x)
    slopes = np.array([
        (np.array(_covariance(best.x + step)) - np.array(_covariance(best.x - step))) / (2 * _STEP)
        for step in _STEP * np.eye(4)
    ]).T  # fmt: skip
    errors = slopes @ np.linalg.pinv(hessian, hermitian=True) @ slopes.T
    return _SharpestWidths(
        covariance_px2=np.array([[xx, xy], [xy, yy]]),
        covariance_err_px2=errors,
        softness_px2=float(np.exp(best.x[3])),
        edges_used=int(np.count_nonzero(sure)),
    )


def _covariance(parameters: FloatArray) -> tuple[float, float, float]:
    """Elements xx, xy, yy from the log mean width, the log ratio of the widths and atanh(rho)."""
    mean, ratio, tilt = (float(value) for value in parameters[:3])
    x, y = exp(mean + ratio / 2), exp(mean - ratio / 2)
    return x * x, tanh(tilt) * x * y, y * y


def _log_modified_gaussian(left: FloatArray, err: FloatArray, mean: float) -> FloatArray:
    """Log density of a Gaussian error plus an exponential variable with this mean.

    Far above the error the tail is exponential; elsewhere erfcx neither overflows nor cancels.
    """
    ratio, scaled = err / mean, left / err
    below = (ratio - scaled) / sqrt(2)
    tail = 0.5 * np.square(np.minimum(ratio, scaled)) - left / mean + log_ndtr(scaled - ratio)
    near = -0.5 * scaled**2 + np.log(erfcx(np.maximum(below, 0.0)) / 2)
    return np.asarray(np.where(below < 0, tail, near) - log(mean), dtype=np.float64)


def _hessian(cost: Callable[[FloatArray], float], point: FloatArray) -> FloatArray:
    steps = _STEP * np.eye(len(point))
    return np.array([
        [
            (cost(point + a + b) - cost(point + a - b) - cost(point - a + b) + cost(point - a - b))
            / (4 * _STEP**2)
            for b in steps
        ]
        for a in steps
    ])  # fmt: skip


_PIXEL_VARIANCE_PX2 = 1.0 / 12.0
_CLIPPED = 0.995
"""Of the level of clipping: averages and noise leave clipped pixels a little below it."""

_MOST_CLIPPED = 0.5
_FILL_PX, _LEAST_FILL = 8.0, 0.01

SCENE_ERR = 0.2
"""Relative error of a scene's widths beyond that of their fit, nearly one factor for x and y.

The RMS of 39 calibrations from four prints, through lenses of 0.4 to 1.3 px.
"""

_ZOOM_OFF = 0.03
"""Relative error of the zoom beyond which it explains why photographs do not match."""

_TRANSFER_FREQ_CY_PER_PX = np.linspace(0.02, 1.3, 65)
_TRANSFER_ANGLES_RAD = np.arange(24) * (pi / 24)

_SHIFT_OFF_PX = 5.0
"""The same for the distance of the centres, near px: a smaller one the alignment takes up."""


def calibrate_from_scene(
    sources: Iterable[EdgeImage],
    *,
    region: Callable[[EdgeImage], Region | None] = lambda _: None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF from the edges in ordinary photographs (method single-image).

    Accurate to some 20 % if the scene's edges are sharper than a pixel, and its errors say so;
    softer scenes give too wide a PSF.
    """
    edges: list[EdgeMeasurement] = []
    names: list[str] = []
    for done, source in enumerate(sources, start=1):
        names.append(source.name)
        # The texture beside an edge in a scene acts as its noise, whatever the camera's is.
        edges.extend(edges_of_image(replace(source, noise=None), region(source)))
        progress(done)
    clear = [edge for edge in edges if "saturated" not in edge.flags and is_clear(edge)]
    try:
        widths = _fit_sharpest_widths(
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
        widths.covariance_err_px2 + _of_widths(widths.covariance_px2, SCENE_ERR),
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

    Of any lens: its transfer is ``transfer_2d``, and the widths are those of the Gaussian with the
    same MTF50 in four directions. ``series`` are photographs of each scene, the nearest first;
    ``zoom`` is the ratio of the distances where matched features do not suffice, ``region`` returns
    the part of the nearest to use. A `PairError` is that of the first pair, if none determines the
    PSF.
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
    together = combined([pair for _, _, pair in found])
    xx, xy, yy = together.gaussian.px2
    gaussian = _calibration(
        np.array([[xx, xy], [xy, yy]]),
        together.gaussian.covariance,
        "two-distance",
        pairs=tuple(_widths(near.name, far.name, pair) for near, far, pair in found),
    )
    return gaussian.model_copy(update={"transfer_2d": _transfer(together.lens, len(found))})


def _transfer(lens: LensEstimate, pairs: int) -> Transfer2d:
    """The transfer over both axes as psf.json stores it."""
    freq, angle = np.meshgrid(_TRANSFER_FREQ_CY_PER_PX, _TRANSFER_ANGLES_RAD)
    fx, fy = (freq * np.cos(angle)).ravel(), (freq * np.sin(angle)).ravel()
    transfer, slopes, weight = lens.without_pixel(fx, fy)
    sampled = SampledLens(
        fx=fx,
        fy=fy,
        transfer=transfer,
        slopes=slopes,
        covariance=lens.covariance,
        weight=weight,
        gaussian_px2=lens.lens[:GAUSSIAN_PARAMETERS],
    )
    return Transfer2d.of_sampled(sampled, pairs)


def _pair(near: EdgeImage, far: EdgeImage, zoom: float | None, region: Region | None) -> PairPsf:
    clipped = ClippedPixels(near=_clipped(near), far=_clipped(far))
    near, far = _filled(near, clipped.near), _filled(far, clipped.far)
    if zoom is None:
        matrix = _registered(near, far)
    else:
        matrix = _centred_zoom(zoom, near.image_dn.shape, far.image_dn.shape)
    image, at = near.image_dn, matrix
    if region is not None:
        near.refuse_beyond_frame(region)
        bottom, right = region.y_px + region.height_px, region.x_px + region.width_px
        window = np.s_[region.y_px : bottom, region.x_px : right]
        image, clipped = image[window], replace(clipped, near=clipped.near[window])
        at = np.array([[1, 0, -region.x_px], [0, 1, -region.y_px], [0, 0, 1]]) @ matrix
    codes = _codes(near)
    if codes is not None and region is not None:
        codes = codes.cropped(region.y_px, region.x_px)
    both = NearAndFar(
        near_dn=image,
        far_dn=far.image_dn,
        clipped=clipped,
        near_noise_dn2=None if near.noise is None else float(near.noise.variance_dn2(image).mean()),
        near_codes=codes,
        far_codes=_codes(far),
    )
    try:
        return pair_psf(both, at)
    except PairError as error:
        if zoom is None or error.reason == "saturated":
            raise
        raise _why_not(near, far, zoom, error) from error


def _codes(source: EdgeImage) -> JpegCompression | None:
    """How a photograph was compressed, if its plane follows from what was."""
    codes = source.compression
    return codes if codes is not None and codes.is_luma else None


def _clipped(source: EdgeImage) -> BoolArray:
    """Pixels that are clipped or masked; their neighbours are left out where they are used."""
    unmeasured = np.zeros(source.image_dn.shape, dtype=np.bool_)
    if source.masked is not None:
        unmeasured = source.masked
    if source.saturation_dn is None:
        return unmeasured
    clipped: BoolArray = np.asarray(source.image_dn >= _CLIPPED * source.saturation_dn)
    if np.mean(clipped) > _MOST_CLIPPED:
        raise PairError(
            f"{source.name}: {100 * np.mean(clipped):.0f} % of the pixels are saturated; "
            "shorten the exposure",
            reason="saturated",
            photographs=(source.name,),
        )
    return clipped | unmeasured


def _filled(source: EdgeImage, clipped: BoolArray) -> EdgeImage:
    """The photograph with clipped pixels at the mean of those around them: no match, no glare."""
    if not clipped.any():
        return source
    image = source.image_dn
    rest = image[~clipped].mean()
    share = gaussian_filter((~clipped).astype(np.float64), _FILL_PX)
    around = gaussian_filter(np.where(clipped, 0.0, image - rest), _FILL_PX)
    filled = np.where(clipped, rest + around / np.maximum(share, _LEAST_FILL), image)
    return replace(source, image_dn=filled)


def _registered(near: EdgeImage, far: EdgeImage) -> FloatArray:
    """Homography from far to near pixels."""
    try:
        pose = register_images(near.image_dn, far.image_dn).pose
    except RegistrationError as error:
        raise PairError(str(error), reason="not_aligned") from error
    if pose.zoom < 1 / LEAST_ZOOM:
        raise PairError(
            f"the second photograph is the nearer one (zoom {pose.zoom:.3f}); give the nearer "
            "photograph first",
            reason="not_aligned",
        )
    return pose.nearest_homography()


def _why_not(near: EdgeImage, far: EdgeImage, zoom: float, error: PairError) -> PairError:
    """The error of photographs that a zoom about their centres does not align, with the cause."""
    try:
        matrix = _registered(near, far)
    except PairError:
        return PairError(
            f"{error}; the far photograph must show the centre of the near one at its centre, "
            f"from {zoom:g} times as far: check --zoom, and do not crop",
            reason=error.reason,
        )
    found = zoom_at_centre(matrix, _shape(far))
    rows, cols = _shape(far)
    u, v, w = matrix @ ((cols - 1) / 2, (rows - 1) / 2, 1.0)
    near_rows, near_cols = _shape(near)
    shift = float(np.hypot(u / w - (near_cols - 1) / 2, v / w - (near_rows - 1) / 2))
    if abs(np.log(found / zoom)) > _ZOOM_OFF:
        if found < LEAST_ZOOM:
            return PairError(
                f"--zoom {zoom:g} does not fit: the photographs are of about equal scale (by their "
                f"features the zoom is {found:.3f}); at least {LEAST_ZOOM} is needed; photograph "
                "from further away",
                reason="one_distance",
            )
        return PairError(
            f"--zoom {zoom:g} does not fit: by their features the zoom is {found:.3f}; leave "
            "--zoom out, or correct it",
            reason="not_aligned",
        )
    if shift > _SHIFT_OFF_PX:
        return PairError(
            f"the centres of the photographs are {shift:.0f} px apart, as after an off-centre crop "
            "or a sideways move, but --zoom assumes that they are the same point; leave "
            "--zoom out",
            reason="not_aligned",
        )
    return error


def _shape(source: EdgeImage) -> tuple[int, int]:
    return source.image_dn.shape[0], source.image_dn.shape[1]


def _centred_zoom(zoom: float, near: tuple[int, ...], far: tuple[int, ...]) -> FloatArray:
    x = (near[1] - 1) / 2 - zoom * (far[1] - 1) / 2
    y = (near[0] - 1) / 2 - zoom * (far[0] - 1) / 2
    return np.array([[zoom, 0.0, x], [0.0, zoom, y], [0.0, 0.0, 1.0]])


def _widths(near: str, far: str, pair: PairPsf) -> PairWidths:
    gaussian = pair.gaussian
    sigma_x, sigma_y = np.sqrt(gaussian.px2[[0, 2]]).tolist()
    err_xx, _, err_yy = np.sqrt(np.diag(gaussian.covariance)).tolist()
    return PairWidths(
        near=near,
        far=far,
        zoom=pair.zoom,
        sigma_x_px=sigma_x,
        sigma_x_err_px=err_xx / (2 * sigma_x),
        sigma_y_px=sigma_y,
        sigma_y_err_px=err_yy / (2 * sigma_y),
    )


def _of_widths(covariance_px2: FloatArray, relative: float) -> FloatArray:
    """Covariance matrix of (xx, xy, yy) from one relative error of all widths."""
    elements = covariance_px2[[0, 0, 1], [0, 1, 1]]
    return (2 * relative) ** 2 * np.outer(elements, elements)


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
