import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from skimage import data

from analysis.detectability.curves import (
    AmbiguousCurveError,
    CurveChoice,
    DetectabilityCurve,
    DetectabilityCurves,
    read_curves,
)
from analysis.detectability.dprime import d_prime_between
from analysis.detectability.scenario import Scenario
from analysis.detectability.sweep import scene_sums
from analysis.detectability.task import DetectionTask, curves_of
from analysis.errors import NotDetectableError, ResultsFileError
from analysis.reports.evaluation import plot_detectability
from analysis.reports.page import png_bytes, svg_bytes
from analysis.results_file import write_results
from calibration.documents import json_object
from simulation import GaussianPsf, Model
from simulation.arrays import FloatArray


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


def on_zooms(zooms: list[float], d_primes: list[float]) -> DetectabilityCurve:
    names = ("dprime", "dprime_low", "dprime_high", "auc")
    return curve(zoom=zooms, **dict.fromkeys(names, d_primes))


# 1/d' goes from 1/4 by 1/2 a zoom, then from 1/2 by 1: d' = 4 / (2 z - 1), then 1 / (z - 1).
def test_between_two_zooms_the_reciprocal_is_straight_and_beyond_the_last_unknown() -> None:
    found = curve().d_prime_at(np.array([0.9, 1.0, 1.1, 1.25, 1.5, 1.75, 2.0, 2.1]))
    np.testing.assert_allclose(found[:7], [4, 4, 10 / 3, 8 / 3, 2, 4 / 3, 1], rtol=1e-14)
    assert np.isnan(found[7])


@pytest.mark.parametrize(
    ("threshold", "zoom"), [(5.0, None), (4.0, 1.0), (3.0, 7 / 6), (1.5, 5 / 3), (0.5, 2.0)]
)
def test_the_largest_zoom_is_where_the_curve_meets_the_threshold(
    threshold: float, zoom: float | None
) -> None:
    assert curve().largest_zoom(threshold) == (zoom and pytest.approx(zoom, rel=1e-14))


def test_a_curve_of_one_zoom_holds_up_to_there() -> None:
    found = on_zooms([1.5], [2.0]).d_prime_at(np.array([1.0, 1.5, 1.6]))
    np.testing.assert_array_equal(found, [2.0, 2.0, np.nan])


def test_beside_a_d_prime_of_nothing_there_is_nothing() -> None:
    lost = on_zooms([1.0, 1.5, 2.0, 2.5], [4.0, 0.0, 0.0, 1.0])
    zooms = np.array([1.0, 1.0 + 1e-12, 1.25, 1.5, 1.75, 2.25, 2.5])
    np.testing.assert_array_equal(lost.d_prime_at(zooms), [4, 0, 0, 0, 0, 0, 1])
    assert lost.largest_zoom(1e-6) == 1.0
    assert lost.largest_zoom(4.0) == 1.0
    with pytest.raises(NotDetectableError) as refused:
        lost.contrast_found(1.25, 1.0)
    assert (refused.value.zoom, refused.value.d_prime) == (1.25, 0.0)


d_prime_values = st.floats(1e-3, 1e3)


@st.composite
def any_curve(draw: st.DrawFn, falling: bool = False) -> DetectabilityCurve:
    d_primes = draw(st.lists(d_prime_values, min_size=1, max_size=8))
    gaps = draw(
        st.lists(st.floats(0.001, 2.0), min_size=len(d_primes) - 1, max_size=len(d_primes) - 1)
    )
    zooms = np.cumsum([draw(st.floats(1.0, 2.0)), *gaps]).tolist()
    return on_zooms(zooms, sorted(d_primes, reverse=True) if falling else d_primes)


@given(known=any_curve(), share=st.floats(0.0, 1.0))
def test_the_reading_is_exact_at_the_zooms_and_never_above_the_straight_line(
    known: DetectabilityCurve, share: float
) -> None:
    zoom = known.zoom[0] + share * (known.zoom[-1] - known.zoom[0])
    straight = float(np.interp(zoom, known.zoom, known.dprime))
    assert 0 < float(known.d_prime_at(zoom)) <= straight * (1 + 1e-12)
    np.testing.assert_array_equal(known.d_prime_at(np.array(known.zoom)), known.dprime)


@given(known=any_curve(), share=st.floats(0.0, 1.0))
def test_between_two_zooms_d_prime_runs_from_one_to_the_other(
    known: DetectabilityCurve, share: float
) -> None:
    for (z0, z1), (d0, d1) in zip(pairwise(known.zoom), pairwise(known.dprime), strict=True):
        places = z0 + (z1 - z0) * np.sort([0.0, share / 2, share, 1.0])
        steps = np.diff(known.d_prime_at(np.minimum(places, z1)))
        assert np.all(steps * np.sign(d1 - d0) >= -1e-9 * max(d0, d1))


@given(known=any_curve(falling=True), share=st.floats(0.0, 1.0))
def test_the_largest_zoom_is_where_d_prime_is_the_threshold(
    known: DetectabilityCurve, share: float
) -> None:
    above = share * (known.dprime[0] - known.dprime[-1])
    threshold = min(known.dprime[-1] + above, known.dprime[0])
    zoom = known.largest_zoom(threshold)
    assert zoom is not None
    reached = float(known.d_prime_at(min(zoom, known.zoom[-1])))
    # d' may fall a millionfold in a thousandth of a zoom, where a rounding of z moves it so far.
    assert reached == pytest.approx(threshold, rel=1e-6)
    further = np.linspace(zoom, known.zoom[-1], 5)[1:-1]
    assert np.all(known.d_prime_at(further) <= threshold * (1 + 1e-6))


@given(known=any_curve(), share=st.floats(0.0, 1.0), factor=st.floats(0.1, 10.0))
def test_between_the_zooms_too_d_prime_is_proportional_to_contrast(
    known: DetectabilityCurve, share: float, factor: float
) -> None:
    zoom = known.zoom[0] + share * (known.zoom[-1] - known.zoom[0])
    stronger = on_zooms(known.zoom, [factor * value for value in known.dprime])
    expected = factor * float(known.d_prime_at(zoom))
    assert float(stronger.d_prime_at(zoom)) == pytest.approx(expected, rel=1e-9)


PHOTOGRAPHS: dict[str, Callable[[], NDArray[np.uint8]]] = {
    "coins": data.coins,
    "gravel": data.gravel,
}


def computed(scene: str, model: Model, noise_dn: float, zooms: list[float]) -> list[FloatArray]:
    """d' of two observers at the zooms: noise against 12 DN, a window of 15 px."""
    scene_dn = PHOTOGRAPHS[scene]()[:180, :220].astype(np.float64)
    task = DetectionTask(
        contrasts_dn=(12.0,),
        noises_dn=(noise_dn,),
        zooms=tuple(zooms),
        models=(model,),
        observers=("npw", "hotelling"),
    )
    scenario = Scenario(psf=GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.9), window_px=15, positions=1)
    plan = replace(task.plan(scenario.psf, 16), scenario=scenario)
    sums = scene_sums(scene_dn, plan)
    artefacts = [sums.artefact(0, index) for index in range(len(zooms))]
    curves = curves_of(lambda _: artefacts, 1, plan, task).curves
    return [np.array(one.dprime) for one in curves]


@pytest.mark.slow
@pytest.mark.parametrize("scene", PHOTOGRAPHS)
@pytest.mark.parametrize("model", ["paper", "matched", "lmmse"])
def test_from_zooms_1_and_1_25_the_reading_is_a_little_low_and_the_straight_line_far_too_high(
    scene: str, model: Model
) -> None:
    """Noise 1 DN. The reading is 2 to 21 % low, the straight line 35 to 95 % high at 1.1 to 1.2."""
    zooms, ends = np.array([1.0, 1.05, 1.1, 1.15, 1.2, 1.25]), [0, -1]
    for direct in computed(scene, model, 1.0, zooms.tolist()):
        read = d_prime_between(zooms[ends], direct[ends], zooms)
        assert np.all(read <= direct)
        assert np.all(read >= 0.78 * direct)
        straight = np.interp(zooms, zooms[ends], direct[ends])
        assert np.all(straight[2:5] >= 1.3 * direct[2:5])


@pytest.mark.parametrize("scene", PHOTOGRAPHS)
def test_bicubic_d_prime_drops_just_beyond_zoom_1_which_a_zoom_of_1_01_tells(scene: str) -> None:
    """Noise 0.5 DN: the pixel grids no longer coincide, and up to half of d' goes at once."""
    zooms = np.array([1.0, 1.01, 1.05, 1.1, 1.15, 1.2, 1.25])
    for direct in computed(scene, "bicubic", 0.5, zooms.tolist()):
        assert direct[1] < 0.85 * direct[0]
        without = d_prime_between(zooms[[0, -1]], direct[[0, -1]], zooms)
        assert without[1] > 1.15 * direct[1]
        read = d_prime_between(zooms[[0, 1, -1]], direct[[0, 1, -1]], zooms)
        assert np.all(read <= 1.03 * direct)
        assert np.all(read >= 0.85 * direct)


def test_half_the_d_prime_needs_half_the_contrast() -> None:
    assert curve().contrast_found(1.5, 1.0) == pytest.approx(6.0)


def test_a_file_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    curves = [curve(), curve(observer="hotelling")]
    write_results(path, DetectabilityCurves(curves=curves, images=3))
    assert read_curves(path).curves == curves
    document = json.loads(path.read_text())
    assert document["schema"] == "standoff.detectability/1"
    assert "upper bound" in document["note"]
    assert set(document["curves"][0]) == {
        *("model", "observer", "noise_dn", "contrast_dn", "signal_sigma_px"),
        *("zoom", "dprime", "dprime_low", "dprime_high", "auc", "seen_sigma_px", "seen_dn"),
        *("dprime_low_scene", "dprime_high_scene", "uncertainty"),
    }


def test_an_ambiguous_choice_says_what_tells_the_curves_apart(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    write_results(path, DetectabilityCurves(curves=[curve(), curve(noise_dn=4.0, observer="cho")]))
    file = read_curves(path)
    with pytest.raises(AmbiguousCurveError) as refused:
        file.chosen(CurveChoice())
    assert refused.value.fitting == tuple(file.curves)
    assert refused.value.open_choices == {"observer": ("cho", "npw"), "noise_dn": (2.0, 4.0)}
    with pytest.raises(AmbiguousCurveError) as refused:
        file.chosen(CurveChoice(noise_dn=3.0))
    assert refused.value.fitting == ()
    assert file.chosen(CurveChoice(noise_dn=4.0)).observer == "cho"


WHOLE = json.dumps(json_object(DetectabilityCurves(curves=[curve()])))


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("{", None),
        ('{"schema": "standoff.psf/1"}', "schema"),
        ('{"schema": "standoff.detectability/1", "curves": []}', "curves"),
        pytest.param(WHOLE.replace("1.5, 2.0]", "1.5]"), "curves.0", id="of two lengths"),
        pytest.param(WHOLE.replace("[1.0, 1.5", "[1.0, 2.5"), "curves.0", id="falling zooms"),
        pytest.param(
            WHOLE.replace("[3.9, 1.9, 0.9]", "[3.9, 1.9, -0.9]"), "curves.0", id="below 0"
        ),
    ],
)
def test_a_broken_file_is_told_by_name(tmp_path: Path, text: str, key: str | None) -> None:
    path = tmp_path / "curves.json"
    path.write_text(WHOLE)
    read_curves(path)
    path.write_text(text)
    with pytest.raises(ResultsFileError) as refused:
        read_curves(path)
    assert (refused.value.source, refused.value.key) == (str(path), key)


def test_a_figure_draws_what_is_read() -> None:
    figure = plot_detectability([curve()], "noise_dn")
    [line] = figure.axes[0].lines
    zoom, d_prime = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert {1.0, 1.5, 2.0} <= set(zoom.tolist())
    np.testing.assert_array_equal(d_prime, curve().d_prime_at(zoom))
    assert len(zoom) > 100


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
