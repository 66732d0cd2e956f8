"""A validation as one JSON document: settings, pairs, both tables, and what did not count."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from analysis.metrics import ImageMetrics
from analysis.paper_tables import PAPER_TABLE_1, PAPER_TABLE_2
from analysis.processing import BACKGROUND_SIGMA_PX, FULL_SCALE_DN
from analysis.results_file import finite_or_null
from analysis.validation import Validation, table_1, table_2
from analysis.validation_pair import PairValidation

__all__ = ["VALIDATION_SCHEMA", "validation_document"]

VALIDATION_SCHEMA = "standoff.validation/1"


def validation_document(validation: Validation, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return a validation as plain lists and numbers; ``facts`` are how it came about."""
    return {
        "schema": VALIDATION_SCHEMA,
        **facts,
        "processing": {
            "normalised_to_dn": [0.0, FULL_SCALE_DN],
            "background_sigma_px": BACKGROUND_SIGMA_PX,
            "crop": "centre half of each axis",
            "data_range_dn": FULL_SCALE_DN,
            "nmi_bins": 100,
            "ssim_window_px": 7,
        },
        "table_1": _rows({row: asdict(error) for row, error in table_1(validation).items()}),
        "table_2": _rows({row: asdict(mean) for row, mean in table_2(validation).items()}),
        "paper_table_1": {model: asdict(row) for model, row in PAPER_TABLE_1.items()},
        "paper_table_2": {model: asdict(row) for model, row in PAPER_TABLE_2.items()},
        "pairs": [_pair(pair) for pair in validation.pairs],
        "excluded": [
            {
                "capture": one.record.index,
                "target": one.record.target,
                "height_mm": one.record.height_mm,
                "reason": one.reason,
            }
            for one in validation.screening.excluded
        ],
        "remarks": list(validation.screening.remarks),
    }


def _rows(table: Mapping[tuple[str, str], dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {"alignment": alignment, "model": model, **finite_or_null(values)}
        for (alignment, model), values in table.items()
    ]


def _pair(pair: PairValidation) -> dict[str, Any]:
    registration = pair.registration
    return {
        "target": pair.reference.target,
        "orientation_deg": pair.reference.orientation_deg,
        "reference": pair.reference.index,
        "followup": pair.followup.index,
        "reference_height_mm": pair.reference.height_mm,
        "followup_height_mm": pair.followup.height_mm,
        "zoom": registration.zoom,
        "homography": registration.pose.matrix.tolist(),
        "k1": registration.pose.k1,
        "k1_err": registration.k1_err,
        "place_err_px": registration.place_err_px,
        "match_rms_px": registration.match_rms_px,
        "matches": registration.inlier_count,
        "captured_curves": {
            alignment: _metrics(curve) for alignment, curve in pair.captured_curves.items()
        },
        "models": [
            {
                "alignment": alignment,
                "model": model,
                "curve": _metrics(one.curve),
                "agreement": _metrics(one.agreement),
            }
            for (alignment, model), one in pair.models.items()
        ],
    }


def _metrics(metrics: ImageMetrics) -> dict[str, Any]:
    return finite_or_null(asdict(metrics))
