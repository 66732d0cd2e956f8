"""The whole chain on the simulated bench, and how close it comes to the bench's truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.plan import CapturePlan
from acquisition.session import Session
from analysis.comparison_plots import plot_processed
from analysis.reports import png_bytes, render_session_report
from analysis.series import SeriesComparison, compare_series, series_of, write_comparison
from calibration.files import read_psf, write_psf
from calibration.psf import Estimate, PsfCalibration, calibrate_psf, edge_images, edge_records
from hil_mocks import BenchTruth
from standoff.terminal import progress_bar
from standoff.workflows.edge_sources import Reading, from_session
from standoff.workflows.reports import RESULTS_FOLDER, make_folder, write_file, write_page
from standoff.workflows.simulated_session import capture_simulated

__all__ = ["DemoResult", "TruthRow", "run_demo"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthRow:
    """One measured value beside the truth of the simulated bench."""

    name: str
    truth: float
    estimate: Estimate

    @property
    def error(self) -> float:
        """Measured less true."""
        return self.estimate.value - self.truth

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
    comparison: SeriesComparison

    def document(self) -> dict[str, Any]:
        """Return the result as plain lists and numbers."""
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
                    "relative_error": row.error / row.truth if row.truth else None,
                }
                for row in self.truth
            ],
            "zooms": [{"truth": true, "measured": found} for true, found in self.zooms],
            "mse": {model: mean.mse_dn2 for model, mean in self.comparison.means.items()},
        }


def run_demo(out: Path, config: BenchConfig, plan: CapturePlan) -> DemoResult:
    """Capture, calibrate, simulate, compare and report, below the directory ``out``.

    A demo that was interrupted goes on where it stopped.

    Raises
    ------
    ApplicationError, AnalysisError, CalibrationError, DeviceError, SessionError
        If a step fails; what the steps before it made stays.
    """
    session_path = out / "session"
    make_folder(out)
    capture_simulated(session_path, config, plan, operator="demo", what="the demo")
    session = Session(session_path)
    results = make_folder(session_path / RESULTS_FOLDER)
    calibration = _calibrate(session)
    write_psf(results / "psf.json", calibration, from_session(session, Reading()).origin)
    stored = read_psf(results / "psf.json")
    with progress_bar("simulating", sum(len(s) - 1 for s in series_of(session))) as bar:
        comparison = compare_series(session, stored.total_psf("psf.json"), bar.advance_to)
    write_comparison(results / "comparison.json", comparison)
    report = out / "report.html"
    write_page(report, render_session_report(session, stored, comparison))
    furthest = max(comparison.pairs, key=lambda pair: pair.comparison.registration.zoom)
    write_file(out / "comparison.png", png_bytes(plot_processed(furthest)))
    truth = BenchTruth(config)
    return DemoResult(
        session=session_path,
        psf=results / "psf.json",
        report=report,
        truth=_beside_truth(calibration, truth, session.records[0].height_mm),
        zooms=tuple(
            (
                truth.zoom(pair.reference.height_mm, pair.followup.height_mm),
                pair.comparison.registration.zoom,
            )
            for pair in comparison.pairs
        ),
        comparison=comparison,
    )


def _calibrate(session: Session) -> PsfCalibration:
    with progress_bar("measuring edges", len(edge_records(session))) as bar:
        return calibrate_psf(edge_images(session), progress=bar.advance_to)


def _beside_truth(
    calibration: PsfCalibration, truth: BenchTruth, height_mm: float
) -> tuple[TruthRow, ...]:
    (xx, xy), (_, yy) = truth.optical_covariance_px2(height_mm).tolist()
    true_values = (
        ("optical sigma_x / px", np.sqrt(xx), calibration.optical_sigma_x_px),
        ("optical sigma_y / px", np.sqrt(yy), calibration.optical_sigma_y_px),
        ("optical rho", xy / np.sqrt(xx * yy), calibration.optical_rho),
    )
    return tuple(
        TruthRow(name=name, truth=float(value), estimate=estimate)
        for name, value, estimate in true_values
        if estimate is not None
    )
