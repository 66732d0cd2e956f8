"""What is scored in each track: its name, its unit, and which way is better."""

from dataclasses import dataclass
from typing import Literal

from analysis.benchmark.stored_models import Track

Better = Literal["less", "more", "near 0", "near 95"]

EVERYTHING = "all"
ANSWERED = "answered"


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """A measure of a track, in the order of the tables; ``is_headline`` is broken down by group."""

    name: str
    title: str
    unit: str
    better: Better
    digits: int = 2
    is_headline: bool = False

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} / {self.unit}" if self.unit else self.title


def _measure(
    name: str,
    title: str,
    unit: str,
    better: Better = "less",
    digits: int = 2,
    is_headline: bool = False,
) -> Measure:
    return Measure(
        name=name, title=title, unit=unit, better=better, digits=digits, is_headline=is_headline
    )


MEASURES: dict[Track, tuple[Measure, ...]] = {
    "psf": (
        _measure(ANSWERED, "edges measured", "%", "more", 1),
        _measure("mtf50_error_median", "MTF50: median error", "%", is_headline=True),
        _measure("mtf50_bias", "MTF50: mean error", "%", "near 0"),
        _measure("mtf50_error_p95", "MTF50: 95th percentile of the error", "%"),
        _measure("mtf_error_rms", "MTF at 0.1 to 0.5 cy/px: rms error", "", digits=4),
        _measure("truth_within_95", "truths within the 95 % stated", "%", "near 95", 1),
    ),
    "simulation": (
        _measure(ANSWERED, "photographs simulated", "%", "more", 1),
        _measure("pixels_predicted", "pixels predicted", "%", "more", 1),
        _measure("error_median", "rms error: median over tasks", "% of contrast", is_headline=True),
        _measure("correlation_median", "correlation: median over tasks", "", "more", 5),
    ),
    "alignment": (
        _measure(ANSWERED, "related pairs aligned", "%", "more", 1),
        _measure("within_0.1_px", "related pairs within 0.1 px", "%", "more", 1),
        _measure("within_0.5_px", "related pairs within 0.5 px", "%", "more", 1, is_headline=True),
        _measure("within_2_px", "related pairs within 2 px", "%", "more", 1),
        _measure("error_median", "error of those aligned: median", "px", digits=3),
        _measure("refused", "related pairs refused", "%", digits=1),
        _measure("unrelated_refused", "unrelated pairs refused", "%", "more", 1),
        _measure("wrong", "wrong answers", "%", digits=1, is_headline=True),
    ),
    "changes": (
        _measure(ANSWERED, "pairs judged", "%", "more", 1),
        _measure("spots_found", "spots found at 1 false place a frame", "%", "more", 1),
        _measure(
            "limit_50_dn", "50 % are found from an amplitude of", "DN", digits=1, is_headline=True
        ),
        _measure("limit_80_dn", "80 % are found from an amplitude of", "DN", digits=1),
        _measure("limit_50_noises", "the same, 50 %, in noises of a pixel", ""),
        _measure("limit_80_noises", "the same, 80 %, in noises of a pixel", ""),
        _measure("limit_50_dn_strict", "50 % at 0.1 false places a frame", "DN", digits=1),
        _measure("false_places", "false places in a changed frame", "", digits=2),
        _measure("auc", "AUC of the largest score", "", "more", 3, is_headline=True),
        _measure("pixels_found", "changed pixels found at 1e-4 false ones", "%", "more", 1),
        _measure("own_precision", "own detections: precision", "%", "more", 1),
        _measure("own_recall", "own detections: recall", "%", "more", 1),
        _measure("own_false_places", "own detections: false places a frame", "", digits=2),
    ),
}

TITLES: dict[Track, str] = {
    "psf": "Sharpness from photographs",
    "simulation": "Photographs from further away",
    "alignment": "Alignment of two photographs",
    "changes": "Changes between two photographs",
}
