"""Standoff itself, by its public library alone."""

import numpy as np
from scipy.ndimage import label

import standoff
from analysis.errors import AnalysisError
from benchmarks.peers.listers import listed, standoff_changes
from benchmarks.peers.program import (
    CONTRAST_FREQ_CY_PER_PX,
    AlignedPoints,
    ChangeScore,
    EdgeContrast,
    PeerError,
    Program,
    Task,
)
from calibration.edges import EdgeMeasurement
from calibration.errors import CalibrationError, RegistrationError
from calibration.psf import PsfCalibration
from calibration.registration import Homography
from simulation.arrays import BoolArray, FloatArray
from simulation.capture_noise import CaptureNoise
from standoff.errors import ApplicationError
from standoff.library.changes import ComparedPhotographs

_ANGLE_DEG = 5.0
"""Within which an edge that was found is the one that is asked for."""

_ROUNDING_DN2 = 1 / 12


def contrasts(task: Task) -> list[EdgeContrast]:
    """The e-SFR of every edge that is not rejected, or the PSF from two distances.

    Where there is no e-SFR, as beside clipped pixels, the Gaussian fit's MTF50 counts.
    """
    if task.facts["kind"] == "photographs":
        try:
            pair = [task.path("nearer_file"), task.path("file")]
            # The zoom that the task gives would be taken for one about the frame's centre.
            psf = standoff.calibrate_psf(pair, method="two-distance", noise=noise_of(task))
        except CalibrationError as error:
            raise PeerError(str(error)) from error
        return along_axes(psf)
    found = standoff.measure_edges(task.path("file"))
    answers = []
    for asked in task.facts["edges"]:
        x0, y0, x1, y1 = asked["roi_px"]
        beside = [
            edge
            for edge in found
            if edge.is_used
            and x0 <= edge.x_px < x1
            and y0 <= edge.y_px < y1
            and abs((edge.angle_deg - asked["angle_deg"] + 90) % 180 - 90) < _ANGLE_DEG
        ]
        if beside:
            longest = max(beside, key=lambda edge: edge.length_px)
            answers.append(_contrast(asked["edge"], longest))
    return answers


def along_axes(psf: PsfCalibration) -> list[EdgeContrast]:
    """Contrasts along x and y of the measured transfer."""
    transfer = psf.transfer_2d
    assert transfer is not None  # of every pair of photographs
    freq, nothing = np.array(CONTRAST_FREQ_CY_PER_PX), np.zeros(len(CONTRAST_FREQ_CY_PER_PX))
    return [
        EdgeContrast(
            edge=axis,
            mtf50=transfer.mtf50_cy_per_px(angle_deg),
            mtf50_standard_error=transfer.mtf50_err_cy_per_px(angle_deg),
            contrasts=tuple(np.abs(transfer.otf(fx, fy)).tolist()),
        )
        for axis, angle_deg, fx, fy in (("x", 0.0, freq, nothing), ("y", 90.0, nothing, freq))
    ]


def _contrast(name: str, edge: EdgeMeasurement) -> EdgeContrast:
    at: tuple[float | None, ...] = (None,) * len(CONTRAST_FREQ_CY_PER_PX)
    if edge.esfr is not None:
        at = tuple(edge.esfr.at(np.array(CONTRAST_FREQ_CY_PER_PX)).tolist())
    if edge.esfr_mtf50_cy_per_px is None:  # beside clipped pixels
        return EdgeContrast(
            edge=name,
            mtf50=edge.mtf50_cy_per_px,
            mtf50_standard_error=edge.mtf50_err_cy_per_px,
            contrasts=at,
        )
    return EdgeContrast(
        edge=name,
        mtf50=edge.esfr_mtf50_cy_per_px,
        mtf50_standard_error=edge.esfr_mtf50_err_cy_per_px,
        contrasts=at,
    )


def _simulated(task: Task) -> FloatArray:
    """The follow-up by model lmmse, with the PSF of the task's chart."""
    rows, cols = task.facts["followup_shape"]
    pose = Homography(matrix=task.homography, size=(cols, rows))
    try:
        made = standoff.simulate(
            task.path("reference"), homography=pose, psf=_calibrated(task), model="lmmse"
        )
    except ApplicationError as error:
        raise PeerError(str(error)) from error
    image = np.asarray(made.image, dtype=np.float64)
    if made.followup.outside is not None:
        image[made.followup.outside] = np.nan
    return image


def _aligned(task: Task) -> AlignedPoints:
    """Where the follow-up's points lie, with the lens's distortion and relief."""
    try:
        found = standoff.register(task.path("reference"), task.path("followup"))
    except RegistrationError as error:
        raise PeerError(str(error)) from error
    x, y = np.array(task.facts["followup_points"], dtype=np.float64).T
    at_y, at_x = found.pose.to_reference_px(y, x)
    return AlignedPoints(points=np.stack([at_x, at_y], axis=1))


def _changed(task: Task) -> ChangeScore:
    """Significance of every pixel, and the list of changes; what a shift explains is none."""
    hints = standoff.RegistrationHints(matrix=task.homography)
    try:
        found = standoff.find_changes(
            task.path("reference"),
            task.path("followup"),
            _calibrated(task),
            noise=noise_of(task),
            hints=hints,
        )
    except (AnalysisError, CalibrationError, ApplicationError) as error:
        raise PeerError(str(error)) from error
    score = np.abs(np.asarray(found.significance, dtype=np.float64))
    score[moved_pixels(found)] = 0
    score[~found.valid] = np.nan
    places = [(change.x_px, change.y_px) for change in found.summary.changes]
    return ChangeScore(score=score, places=np.array(places).reshape(-1, 2))


def moved_pixels(found: ComparedPhotographs) -> BoolArray:
    """What a shift explains, with what stands out around it by the wider filters alone."""
    moved = found.is_moved.copy()
    for sign in (-1, 1):
        labels, _ = label(sign * found.significance > found.summary.threshold_sd)
        halos = np.setdiff1d(labels[found.is_moved], labels[found.is_change])
        moved |= np.isin(labels, halos[halos > 0])
    return moved


def _calibrated(task: Task) -> PsfCalibration:
    try:
        return standoff.calibrate_psf(task.path("chart"), noise=noise_of(task))
    except CalibrationError as error:
        raise PeerError(f"chart: {error}") from error


def noise_of(task: Task) -> CaptureNoise | None:
    """The noise of linear pictures; that of encoded ones is estimated."""
    noise = task.facts["noise"]
    if not task.is_linear or noise["variance_per_dn"] <= 0:
        return None
    gain = 1 / float(noise["variance_per_dn"])
    read_dn2 = max(float(noise["variance_at_black_dn2"]) - _ROUNDING_DN2, 0.0)
    return CaptureNoise(
        gain_e_per_dn=gain,
        read_noise_e=gain * float(np.sqrt(read_dn2)),
        black_level_dn=float(task.facts["black_level"]),
    )


PROGRAMS = (
    Program(
        name="standoff",
        given="this project by its public library: files, the PSF of the task's chart, the noise "
        "of linear pictures, the homography and zoom where a task gives them",
        answers={
            "psf": contrasts,
            "simulation": _simulated,
            "alignment": _aligned,
            "changes": _changed,
            "things": lambda task: listed(task, standoff_changes),
        },
        packages=("standoff",),
    ),
)
