"""The paper's experiment on the simulated bench: captures, calibration, tables and figures."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.plan import CapturePlan
from acquisition.session import Session
from analysis.validation import Validation, ValidationSettings
from calibration.edges import EdgeImage, EdgeSelection, Region
from calibration.files import read_psf, write_psf
from calibration.psf import calibrate_psf, edge_images, edge_records
from calibration.registration import DistortedPose
from hil_mocks import BenchTruth, CameraPose
from standoff.library.call import Call
from standoff.library.files import RESULTS_FOLDER, make_folder
from standoff.library.psf import Reading, from_session
from standoff.library.rehearsal.simulated_session import capture_simulated
from standoff.library.sessions import run_validation

SHORT_WIDTH_PX, SHORT_HEIGHT_PX = 260, 192
_TRUTH_STEP_PX = 5
_BORDER_PX = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperResult:
    """Results of the experiment; ``registration_errors_px`` has one error per pair.

    An error is the median over the frame, in reference px, against the bench's truth.
    """

    validation: Validation
    registration_errors_px: tuple[float, ...]


def short_bench(config: BenchConfig) -> BenchConfig:
    """Return the bench with a ninth of the pixels, each larger, and the same field of view."""
    assert config.simulated is not None
    pitch_um = config.optics.pixel_pitch_um * config.simulated.width_px / SHORT_WIDTH_PX
    return config.model_copy(
        update={
            "optics": config.optics.model_copy(update={"pixel_pitch_um": pitch_um}),
            "simulated": config.simulated.model_copy(
                update={"width_px": SHORT_WIDTH_PX, "height_px": SHORT_HEIGHT_PX}
            ),
        }
    )


def run_paper(
    call: Call, out: Path, config: BenchConfig, plan: CapturePlan, settings: ValidationSettings
) -> PaperResult:
    """Capture, calibrate for the centre, and validate, below the folder ``out``.

    After an interruption, the same command resumes where it stopped.

    Raises
    ------
    AnalysisError, ApplicationError, CalibrationError, DeviceError, SessionError
        If a step fails; the results of the steps before it are kept.
    """
    make_folder(out)
    session_path = out / "session"
    capture_simulated(
        call, session_path, config, plan, operator="paper", what="the paper's experiment"
    )
    session = Session(session_path)
    psf_path = make_folder(session_path / RESULTS_FOLDER) / "psf.json"
    _calibrate_centre(call, session, psf_path)
    psf = read_psf(psf_path).best_psf(str(psf_path))
    validation = run_validation(call, out, session, psf, str(psf_path), settings)
    truth = BenchTruth(config)
    assert config.simulated is not None
    shape = config.simulated.height_px, config.simulated.width_px
    errors = tuple(
        float(
            np.median(
                place_errors_px(
                    pair.pose(shape, shape),
                    truth,
                    pair.reference_height_mm,
                    pair.followup_height_mm,
                )
            )
        )
        for pair in validation.pairs
    )
    return PaperResult(validation=validation, registration_errors_px=errors)


def place_errors_px(
    pose: DistortedPose, truth: BenchTruth, near_mm: float, far_mm: float
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Distance in the reference between true pixel positions and those given by a pose.

    Parameters
    ----------
    pose
        Pose of a follow-up relative to its reference, both from an upright camera.
    truth
        Truth of the bench.
    near_mm, far_mm
        Heights of reference and follow-up.

    Returns
    -------
    ndarray of float64, shape (n,)
        For every fifth follow-up pixel along both axes that the reference shows.
    """
    rows, cols = pose.followup_shape
    y, x = np.mgrid[0:rows:_TRUTH_STEP_PX, 0:cols:_TRUTH_STEP_PX].astype(np.float64)
    on_plane = truth.camera.to_plane_mm(x, y, CameraPose(height_mm=far_mm))
    true_x, true_y = truth.camera.to_pixel(*on_plane, CameraPose(height_mm=near_mm))
    found_y, found_x = pose.to_reference_px(y, x)
    shown = (
        (true_x > _BORDER_PX)
        & (true_x < pose.reference_shape[1] - 1 - _BORDER_PX)
        & (true_y > _BORDER_PX)
        & (true_y < pose.reference_shape[0] - 1 - _BORDER_PX)
    )
    return np.asarray(np.hypot(found_x - true_x, found_y - true_y)[shown])


def _calibrate_centre(call: Call, session: Session, path: Path) -> None:
    def centre(source: EdgeImage) -> Region:
        return Region.centre(*source.frame)

    with call.bar("measuring edges", len(edge_records(session))) as advance_to:
        calibration = calibrate_psf(
            edge_images(session),
            selection=EdgeSelection(region=centre),
            progress=advance_to,
        )
    origin = replace(
        from_session(session, Reading()).origin,
        region="centre",
        provenance=call.provenance_of(session),
    )
    write_psf(path, calibration.with_origin(origin))
