import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.detectability_curves import (
    AmbiguousCurveError,
    CurveChoice,
    DetectabilityCurve,
    curves_document,
    read_curves,
    write_curves,
)
from analysis.detectability_plots import plot_detectability
from analysis.errors import ResultsFileError
from analysis.report_page import png_bytes, svg_bytes


def curve(**values: Any) -> DetectabilityCurve:
    about: dict[str, Any] = {
        "model": "matched",
        "observer": "npw",
        "noise_dn": 2.0,
        "contrast_dn": 12.0,
        "signal_sigma_px": 2.0,
        "zoom": [1.0, 1.5, 2.0],
        "dprime": [4.0, 2.0, 1.0],
        "dprime_low": [3.9, 1.9, 0.9],
        "dprime_high": [4.1, 2.1, 1.1],
        "auc": [0.99, 0.92, 0.76],
    }
    return DetectabilityCurve(**(about | values))


def test_between_two_zooms_d_prime_is_linear_and_beyond_the_last_unknown() -> None:
    found = curve().d_prime_at(np.array([0.9, 1.25, 2.0, 2.1]))
    np.testing.assert_array_equal(found[:3], [4.0, 3.0, 1.0])
    assert np.isnan(found[3])


@pytest.mark.parametrize(
    ("threshold", "zoom"), [(5.0, None), (4.0, 1.0), (3.0, 1.25), (1.5, 1.75), (0.5, 2.0)]
)
def test_the_largest_zoom_is_where_the_curve_meets_the_threshold(
    threshold: float, zoom: float | None
) -> None:
    assert curve().largest_zoom(threshold) == zoom


def test_half_the_d_prime_needs_half_the_contrast() -> None:
    assert curve().contrast_found(1.5, 1.0) == pytest.approx(6.0)


def test_a_file_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    curves = [curve(), curve(observer="hotelling")]
    write_curves(path, curves_document(curves, images=3))
    assert read_curves(path).curves == curves
    document = json.loads(path.read_text())
    assert document["schema"] == "standoff.detectability/1"
    assert "upper bound" in document["note"]
    assert set(document["curves"][0]) == {
        *("model", "observer", "noise_dn", "contrast_dn", "signal_sigma_px"),
        *("zoom", "dprime", "dprime_low", "dprime_high", "auc"),
    }


def test_an_ambiguous_choice_says_what_tells_the_curves_apart(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    write_curves(path, curves_document([curve(), curve(noise_dn=4.0, observer="cho")]))
    file = read_curves(path)
    with pytest.raises(AmbiguousCurveError, match=r"--observer \(cho, npw\) and --noise \(2, 4\)"):
        file.chosen(CurveChoice())
    with pytest.raises(AmbiguousCurveError, match="no curve fits"):
        file.chosen(CurveChoice(noise_dn=3.0))
    assert file.chosen(CurveChoice(noise_dn=4.0)).observer == "cho"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a curves.json"),
        ('{"schema": "standoff.psf/1"}', "schema is 'standoff.psf/1'"),
        ('{"schema": "standoff.detectability/1", "curves": []}', "curves: "),
        (
            json.dumps(curves_document([curve()])).replace("[1.0, 1.5, 2.0]", "[1.0, 1.5]"),
            "dprime has 3 values",
        ),
        (
            json.dumps(curves_document([curve()])).replace("[1.0, 1.5, 2.0]", "[1.0, 2.5, 2.0]"),
            "zoom must rise",
        ),
    ],
)
def test_a_broken_file_is_told_by_name(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "curves.json"
    path.write_text(text)
    with pytest.raises(ResultsFileError, match=message):
        read_curves(path)
    with pytest.raises(ResultsFileError, match="cannot read"):
        read_curves(tmp_path / "none.json")


def test_the_figures_name_axes_units_and_every_curve() -> None:
    curves = [
        curve(model=model, observer=observer, noise_dn=noise)
        for model in ("paper", "matched")
        for observer in ("npw", "cho")
        for noise in (1.0, 2.0)
    ]
    figure = plot_detectability(curves, "noise_dn")
    assert len(figure.axes) == 2
    assert all(len(axes.lines) == 4 for axes in figure.axes)
    assert "upper bound" in figure.axes[0].get_ylabel()
    [legend] = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        *("paper", "matched"),
        *("noise 1 DN", "noise 2 DN"),
    ]
    assert png_bytes(figure).startswith(b"\x89PNG")
    assert b"<svg" in svg_bytes(figure)
