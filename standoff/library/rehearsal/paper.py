"""The paper's experiment on the simulated bench: captures, calibration, tables and figures."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.files import RESULTS_FOLDER, make_folder
from acquisition.plan import load_plan
from acquisition.session import Session
from analysis.choices import PAPER_TRAINING_STEPS, ValidationModel
from analysis.validation import KernelBook, Validation, ValidationSettings
from calibration.documents import json_object
from calibration.edges import EdgeImage, EdgeSelection, Region
from calibration.files import read_psf, write_psf
from calibration.psf import edge_images, edge_records, psf_of_images
from hil_mocks import BenchTruth
from standoff.library.call import Call, Progress
from standoff.library.edges import Reading, from_session
from standoff.library.rehearsal.simulated_session import capture_simulated
from standoff.library.validation import default_models, run_validation
from standoff.shipped_configs import shipped_config

SHORT_WIDTH_PX, SHORT_HEIGHT_PX = 260, 192
_SHORT_STEPS = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperResult:
    """Results of the experiment; ``registration_errors_px`` has one error per pair.

    An error is the median over the frame, in reference px, against the bench's truth.
    """

    validation: Validation
    registration_errors_px: tuple[float, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the result as ``standoff paper --json`` prints it."""
        errors_px = list(self.registration_errors_px)
        return {**json_object(self.validation), "registration_errors_px": errors_px}


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
    out: Path,
    config: BenchConfig,
    *,
    models: Iterable[ValidationModel] | None = None,
    workers: int = 2,
    is_short: bool = False,
    progress: Progress | None = None,
) -> PaperResult:
    """Capture, calibrate for the centre, and validate, below the folder ``out``.

    The bench is a simulated one, such as ``paper_bench.toml``; a short trial has a ninth of its
    pixels and few heights and training steps. After an interruption, the same call resumes where
    it stopped.

    Raises
    ------
    AnalysisError, ApplicationError, CalibrationError, DeviceError, SessionError
        If a step fails; the results of the steps before it are kept.
    """
    call = Call("run_paper", progress)
    steps = _SHORT_STEPS if is_short else PAPER_TRAINING_STEPS
    settings = ValidationSettings(
        models=default_models(call) if models is None else tuple(models),
        kernels=KernelBook(folder=out / "kernels", steps=steps),
        workers=1 if is_short else workers,
    )
    config = short_bench(config) if is_short else config
    name = "paper_validation_short.toml" if is_short else "paper_validation.toml"
    plan = load_plan(shipped_config(name))
    make_folder(out)
    session_path = out / "session"
    capture_simulated(
        call, session_path, config, plan, operator="paper", what="the paper's experiment"
    )
    session = Session(session_path)
    psf_path = make_folder(session_path / RESULTS_FOLDER) / "psf.json"
    _calibrate_centre(call, session, psf_path)
    calibration = read_psf(psf_path)
    psf = calibration.best_psf(str(psf_path))
    settings = replace(settings, calibration=calibration)
    validation = run_validation(call, out, session, psf, str(psf_path), settings)
    truth = BenchTruth(config)
    assert config.simulated is not None
    shape = config.simulated.height_px, config.simulated.width_px
    errors = tuple(
        float(
            np.median(
                truth.place_errors_px(
                    pair.pose(shape, shape), pair.reference_height_mm, pair.followup_height_mm
                )
            )
        )
        for pair in validation.pairs
    )
    return PaperResult(validation=validation, registration_errors_px=errors)


def _calibrate_centre(call: Call, session: Session, path: Path) -> None:
    def centre(source: EdgeImage) -> Region:
        return Region.centre(*source.frame)

    with call.bar("measuring edges", len(edge_records(session))) as advance_to:
        calibration = psf_of_images(
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
