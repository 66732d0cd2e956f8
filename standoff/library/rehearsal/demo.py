"""The whole chain on the simulated bench beside its truth, and changes on real photographs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.files import RESULTS_FOLDER, Provenance, make_folder, write_file
from acquisition.plan import load_plan
from acquisition.session import Session
from analysis.reports import plot_furthest, png_bytes
from analysis.validation import Validation, furthest_pair
from calibration.files import write_psf
from calibration.psf import Estimate, PsfCalibration, edge_images, edge_records, psf_of_images
from hil_mocks import BenchTruth
from standoff.library.call import Call, Progress
from standoff.library.edges import Reading, from_session
from standoff.library.rehearsal.real_pair import DEMO_PHOTOGRAPHS, RealPair, compare_real_pair
from standoff.library.rehearsal.simulated_session import capture_simulated
from standoff.library.validation import session_validation, write_session_report
from standoff.shipped_configs import shipped_config

_PAGE, _PICTURE = "report.html", "comparison.png"
DEMO_FILES = (_PAGE, _PICTURE, *DEMO_PHOTOGRAPHS)
"""What ``run_demo`` writes beside its session."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthRow:
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
    truth: tuple[TruthRow, ...]
    zooms: tuple[tuple[float, float], ...]
    validation: Validation
    real_pair: RealPair
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
            "photographs": self.real_pair.to_json(),
            "provenance": self.provenance.model_dump(mode="json"),
        }


def run_demo(out: Path, config: BenchConfig, *, progress: Progress | None = None) -> DemoResult:
    """Capture, calibrate, simulate, compare and report, below the folder ``out``.

    The bench is a simulated one, such as ``demo_bench.toml``. An interrupted demo resumes where it
    stopped.

    Raises
    ------
    ApplicationError, AnalysisError, CalibrationError, DeviceError, SessionError
        If a step fails; the results of the steps before it are kept.
    """
    call, session_path = Call("run_demo", progress), out / "session"
    plan = load_plan(shipped_config("demo_plan.toml"))
    make_folder(out)
    capture_simulated(call, session_path, config, plan, operator="demo", what="the demo")
    session = Session(session_path)
    results = make_folder(session_path / RESULTS_FOLDER)
    origin = from_session(session, Reading()).origin
    calibration = _calibrate(call, session).with_origin(
        replace(origin, provenance=call.provenance_of(session))
    )
    psf_path = results / "psf.json"
    write_psf(psf_path, calibration)
    name = str(psf_path)
    psf = calibration.best_psf(name)
    validation = session_validation(call, session, psf, name, calibration)
    real_pair = compare_real_pair(call, out)
    report = out / _PAGE
    write_session_report(call, session, report, real_pair.sections())
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
        provenance=call.provenance_of(session),
    )


def _calibrate(call: Call, session: Session) -> PsfCalibration:
    with call.bar("measuring edges", len(edge_records(session))) as advance_to:
        return psf_of_images(edge_images(session), progress=advance_to)


def _beside_truth(
    calibration: PsfCalibration, truth: BenchTruth, height_mm: float
) -> tuple[TruthRow, ...]:
    (xx, xy), (_, yy) = truth.optical_covariance_px2(height_mm).tolist()
    lens = calibration.optical
    true_values = (
        ("optical sigma_x / px", np.sqrt(xx), lens.sigma_x_px),
        ("optical sigma_y / px", np.sqrt(yy), lens.sigma_y_px),
        ("optical rho", xy / np.sqrt(xx * yy), lens.rho),
    )
    return tuple(
        TruthRow(name=name, truth=float(value), estimate=estimate)
        for name, value, estimate in true_values
        if estimate is not None
    )
