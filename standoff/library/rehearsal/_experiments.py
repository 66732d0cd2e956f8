"""The demo and the paper's experiment: the whole chain on the simulated bench, beside its truth."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.capture import RunOperator, run_plan
from acquisition.files import RESULTS_FOLDER, Provenance, make_folder, write_file
from acquisition.plan import CapturePlan, load_plan, plan_entries
from acquisition.session import Session
from analysis.choices import PAPER_TRAINING_STEPS, ValidationModel
from analysis.reports import plot_furthest, png_bytes
from analysis.validation import KernelBook, Validation, ValidationSettings, furthest_pair
from calibration.documents import json_object
from calibration.edges import EdgeSelection, Region
from calibration.files import read_psf, write_psf
from calibration.psf import Estimate, PsfCalibration, edge_images, edge_records, psf_of_images
from hil_mocks import BenchTruth
from standoff.errors import ApplicationError
from standoff.library.bench import devices_of, open_bench, place_in_simulation
from standoff.library.call import Call, Progress
from standoff.library.edges import Reading, from_session
from standoff.library.rehearsal._real_pair import DEMO_PHOTOGRAPHS, RealPair, compare_real_pair
from standoff.library.rehearsal._taken_away import LANTERN_PHOTOGRAPHS, TakenAway, compare_lantern
from standoff.library.validation import (
    default_models,
    run_validation,
    session_validation,
    write_session_report,
)
from standoff.shipped_configs import shipped_config

_PAGE, _PICTURE = "report.html", "comparison.png"
DEMO_FILES = (_PAGE, _PICTURE, *DEMO_PHOTOGRAPHS, *LANTERN_PHOTOGRAPHS)
"""What ``run_demo`` writes beside its session."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _TruthRow:
    """One measured value with the true value of the simulated bench."""

    name: str
    truth: float
    estimate: Estimate

    @property
    def error(self) -> float:
        """Measured minus true value."""
        return self.estimate.value - self.truth

    @property
    def relative_error(self) -> float | None:
        """The error as a fraction of the true value; None if that is 0."""
        return self.error / self.truth if self.truth else None

    @property
    def is_inside(self) -> bool:
        """Whether the 95 % interval contains the truth."""
        return self.estimate.low <= self.truth <= self.estimate.high


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoResult:
    """What the demo measured, and where its files are."""

    session: Path
    psf: Path
    report: Path
    truth: tuple[_TruthRow, ...]
    zooms: tuple[tuple[float, float], ...]
    validation: Validation
    real_pair: RealPair
    taken_away: TakenAway
    provenance: Provenance

    def to_json(self) -> dict[str, Any]:
        """Return the result as ``standoff demo --json`` prints it."""
        return {
            "session": str(self.session),
            "psf": str(self.psf),
            "report": str(self.report),
            "truth": [
                {
                    "name": row.name,
                    "truth": row.truth,
                    "measured": row.estimate.value,
                    "err": row.estimate.err,
                    "interval_95": [row.estimate.low, row.estimate.high],
                    "relative_error": row.relative_error,
                }
                for row in self.truth
            ],
            "zooms": [{"truth": true, "measured": found} for true, found in self.zooms],
            "mse": {
                model: mean.mse_dn2
                for model, mean in self.validation.means("followup-grid").items()
            },
            "photographs": {
                **self.real_pair.to_json(),
                "taken_away": self.taken_away.to_json(),
            },
            "provenance": self.provenance.model_dump(mode="json"),
        }


def run_demo(out: Path, config: BenchConfig, *, progress: Progress | None = None) -> DemoResult:
    """Capture, calibrate, simulate, compare and report, below the folder ``out``.

    The bench is a simulated one, such as ``demo_bench.toml``. An interrupted demo resumes where it
    stopped; the results of the steps before a failure are kept.
    """
    call, session_path = Call("run_demo", progress), out / "session"
    plan = load_plan(shipped_config("demo_plan.toml"))
    make_folder(out)
    session = _capture_simulated(call, session_path, config, plan, operator="demo", what="the demo")
    results = make_folder(session_path / RESULTS_FOLDER)
    calibration = _calibrated(call, session, EdgeSelection())
    psf_path = results / "psf.json"
    write_psf(psf_path, calibration)
    name = str(psf_path)
    psf = calibration.best_psf(name)
    validation = session_validation(call, session, psf, name, calibration)
    taken_away, real_pair = compare_lantern(call, out), compare_real_pair(call, out)
    report = out / _PAGE
    write_session_report(call, session, report, (taken_away.section(), *real_pair.sections()))
    furthest = furthest_pair(session, validation, psf)
    write_file(out / _PICTURE, png_bytes(plot_furthest(furthest)))
    truth = BenchTruth(config)
    return DemoResult(
        session=session_path,
        psf=psf_path,
        report=report,
        truth=_beside_truth(calibration, truth, session.records[0].height_mm),
        zooms=tuple(
            (truth.zoom(pair.reference_height_mm, pair.followup_height_mm), pair.zoom)
            for pair in validation.pairs
        ),
        validation=validation,
        real_pair=real_pair,
        taken_away=taken_away,
        provenance=call.provenance_of(session),
    )


def _calibrated(
    call: Call, session: Session, selection: EdgeSelection, region: str | None = None
) -> PsfCalibration:
    with call.bar("measuring edges", len(edge_records(session))) as advance_to:
        found = psf_of_images(edge_images(session), selection=selection, progress=advance_to)
    origin = from_session(session, Reading()).origin
    return found.with_origin(replace(origin, region=region, provenance=call.provenance_of(session)))


def _beside_truth(
    calibration: PsfCalibration, truth: BenchTruth, height_mm: float
) -> tuple[_TruthRow, ...]:
    (xx, xy), (_, yy) = truth.optical_covariance_px2(height_mm).tolist()
    lens = calibration.optical
    true_values = (
        ("optical sigma_x / px", np.sqrt(xx), lens.sigma_x_px),
        ("optical sigma_y / px", np.sqrt(yy), lens.sigma_y_px),
        ("optical rho", xy / np.sqrt(xx * yy), lens.rho),
    )
    return tuple(
        _TruthRow(name=name, truth=float(value), estimate=estimate)
        for name, value, estimate in true_values
        if estimate is not None
    )


def _capture_simulated(
    call: Call, path: Path, config: BenchConfig, plan: CapturePlan, *, operator: str, what: str
) -> Session:
    """Capture a session at ``path``, or what it still lacks; ``what`` names the work."""
    if config.camera.driver != "simulated":  # before a real one is opened and configured
        raise ApplicationError(f"{what} runs on the simulated bench only")
    with (
        open_bench(config) as devices,
        call.bar("capturing", len(plan_entries(plan))) as advance_to,
    ):
        assert devices.simulated is not None
        person = RunOperator(
            name=operator,
            place=place_in_simulation(devices.simulated),
            progress=lambda done: advance_to(done.captured),
        )
        run_plan(path, plan, devices_of(devices, config), person)
    return Session(path)


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
    session = _capture_simulated(
        call, session_path, config, plan, operator="paper", what="the paper's experiment"
    )
    psf_path = make_folder(session_path / RESULTS_FOLDER) / "psf.json"
    centre = EdgeSelection(region=lambda source: Region.centre(*source.frame))
    write_psf(psf_path, _calibrated(call, session, centre, "centre"))
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
