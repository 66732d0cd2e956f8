"""How sure a d' is: closed forms of its errors, and a scene whose d' is known in closed form."""

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import exp, log
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.special import ndtr
from skimage import data

from analysis.choices import Observer
from analysis.detectability import (
    AmbiguousCurveError,
    CurveChoice,
    CurveUncertainty,
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask,
    DPrimeErrors,
    DPrimeSlopes,
    ErrorSources,
    Scenario,
    curves_figure,
    curves_of,
    curves_of_images,
    d_prime_between,
    focus_spread,
    read_curves,
    scene_sums,
)
from analysis.detectability._curves import registration_spread
from analysis.errors import NotDetectableError, ResultsFileError
from analysis.reports import plot_detectability, png_bytes, svg_bytes
from analysis.results_file import write_results
from benchmarks.truth.gaussian_scenes import GaussianScene, true_d_prime
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


def of_two_zooms(**values: Any) -> DetectabilityCurve:
    about: dict[str, Any] = {
        "observer": "hotelling",
        "zoom": [1.0, 2.0],
        "dprime": [4.0, 2.0],
        "dprime_low": [3.0, 1.5],
        "dprime_high": [5.0, 2.5],
        "auc": [0.9, 0.8],
    }
    return curve(**(about | values))


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


@pytest.mark.slow
@given(known=any_curve(), share=st.floats(0.0, 1.0))
def test_the_reading_is_exact_at_the_zooms_and_never_above_the_straight_line(
    known: DetectabilityCurve, share: float
) -> None:
    zoom = known.zoom[0] + share * (known.zoom[-1] - known.zoom[0])
    straight = float(np.interp(zoom, known.zoom, known.dprime))
    assert 0 < float(known.d_prime_at(zoom)) <= straight * (1 + 1e-12)
    np.testing.assert_array_equal(known.d_prime_at(np.array(known.zoom)), known.dprime)


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


PSF_PX2 = 0.64
ZOOMS = (1.2, 1.57)
SCENE = GaussianScene()


def slopes(**stated: float) -> DPrimeSlopes:
    return DPrimeSlopes(**({"psf_per_px2": -1.25, "noise": -0.2} | stated))


def test_normal_errors_add_in_quadrature() -> None:
    sources = ErrorSources(psf_variance_err_px2=0.02, noise_relative_err=0.1)
    found = CurveUncertainty(sources=sources, scene=[0.03], slopes=[slopes()])
    errors = found.errors([1.5], 1.5)
    expected = (0.03**2 + 0.025**2 + 0.02**2) ** 0.5  # closed form
    assert errors.standard_error == pytest.approx(expected)
    low, high = errors.interval(2.0)
    assert (log(low / 2), log(high / 2)) == pytest.approx((-1.96 * expected, 1.96 * expected), 1e-4)
    assert errors.probability_of(1.9, 2.0) == pytest.approx(float(ndtr(log(2 / 1.9) / expected)))
    assert [one.source for one in errors.budget] == ["scene", "psf", "noise"]
    assert sum(one.share for one in errors.budget) == pytest.approx(1)


def test_a_focus_that_blurs_the_signal_alone_scatters_normally() -> None:
    spread = focus_spread(slopes(signal_per_px2=-2.0), 0.05)
    assert spread.variance == pytest.approx(0.1**2, rel=2e-3)  # closed form
    errors = DPrimeErrors(variances={"scene": 0.02**2}, spreads={"focus": spread})
    reach = 1.959964 * (0.1**2 + 0.02**2) ** 0.5
    assert errors.interval(1.0) == pytest.approx((exp(-reach), exp(reach)), rel=5e-3)


def test_a_registration_error_lowers_d_prime_as_its_integral_says() -> None:
    spread = registration_spread(0.5)
    # E ln(1 + q u) / 2 with u exponential is exp(1 / q) E1(1 / q) / 2: E1(2) = 0.0489005107.
    assert float(spread.weights @ spread.values) == pytest.approx(
        -0.5 * exp(2) * 0.0489005107, rel=5e-3
    )
    assert np.all(spread.values <= 0)


@pytest.mark.slow
@given(
    st.floats(0.1, 5), st.floats(0.1, 5), st.floats(0.001, 0.3), st.floats(0, 0.2), st.floats(-3, 3)
)
def test_the_interval_and_the_probability_say_the_same(
    d_prime: float, threshold: float, err: float, scatter_px2: float, signal: float
) -> None:
    focus = focus_spread(slopes(signal_per_px2=signal, followup_per_px4=5.0), scatter_px2)
    errors = DPrimeErrors(variances={"scene": err**2}, spreads={"focus": focus})
    low, high = errors.interval(d_prime)
    assert low <= high
    assert errors.probability_of(low, d_prime) == pytest.approx(0.975, abs=1e-4)
    assert errors.probability_of(high, d_prime) == pytest.approx(0.025, abs=1e-4)
    probability = errors.probability_of(threshold, d_prime)
    assert (threshold <= low) <= (probability >= 0.9749)
    assert (threshold >= high) <= (probability <= 0.0251)


def test_what_is_not_known_is_named_and_counts_for_nothing() -> None:
    found = CurveUncertainty(scene=[0.1], slopes=[slopes(signal_per_px2=-3.0)])
    assert found.sources.unknown == ("psf", "focus", "noise", "registration")
    assert found.errors([1.0], 1.0).standard_error == pytest.approx(0.1)


def _curve(images: int, psf: GaussianPsf, seed: int) -> DetectabilityCurve:
    rng = np.random.default_rng(seed)
    scenes = [SCENE.photograph(400, PSF_PX2, rng) for _ in range(images)]
    task = DetectionTask(
        noises_dn=(2.0,), models=("matched",), observers=("hotelling",), zooms=ZOOMS
    )
    return curves_of_images(scenes, psf, task).curves[0]


@pytest.mark.slow
def test_d_prime_is_that_of_a_scene_known_in_closed_form() -> None:
    found = _curve(6, GaussianPsf(sigma_px=PSF_PX2**0.5), 5)
    expected = [true_d_prime(SCENE, PSF_PX2, zoom, 2.0, 12.0) for zoom in ZOOMS]
    assert found.dprime == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_slopes_are_those_of_the_closed_form() -> None:
    found = _curve(4, GaussianPsf(sigma_px=PSF_PX2**0.5), 6)
    assert found.uncertainty is not None
    step_px2 = 0.05
    for zoom, slope in zip(ZOOMS, found.uncertainty.slopes, strict=True):
        ends = [
            [
                log(true_d_prime(SCENE, PSF_PX2, zoom, 2.0, 12.0, (sign * a, sign * b)))
                for sign in (-1, 1)
            ]
            for a, b in ((0.0, step_px2), (step_px2, 0.0))
        ]
        followup, reference = ((high - low) / (2 * step_px2) for low, high in ends)
        own = slope.signal_per_px2 - slope.with_followup_per_px2
        assert own == pytest.approx(followup, rel=0.06)
        assert -slope.with_reference_per_px2 == pytest.approx(reference, rel=0.06)


def test_a_curve_of_before_is_judged_by_its_interval() -> None:
    old = of_two_zooms(
        dprime_low=[4 * exp(-0.2), 2 * exp(-0.2)], dprime_high=[4 * exp(0.2), 2 * exp(0.2)]
    )
    assert old.errors_at(2.0).standard_error == pytest.approx(0.2 / 1.959964)
    assert old.with_sources(ErrorSources(focus_scatter_px2=1.0)) == old


def test_too_few_photographs_are_told_how_many_would_do() -> None:
    def document(err: float, images: int) -> DetectabilityCurves:
        found = CurveUncertainty(scene=[err], slopes=[slopes()])
        known = curve(
            zoom=[1.5],
            dprime=[2.0],
            dprime_low=[1.0],
            dprime_high=[3.0],
            auc=[0.9],
            uncertainty=found,
        )
        return DetectabilityCurves(images=images, curves=[known]).with_need()

    assert document(0.05, 4).photographs_needed is None  # 1.96 * .05 is below .1
    few = document(0.1, 4)
    assert few.photographs_needed == 16  # 4 (.196 / .1)^2 = 15.4
    assert (few.too_few_sentence or "").startswith("4 photographs leave d' uncertain by up to 20 %")
    assert "about 16 of the scene" in (few.too_few_sentence or "")


MODELS: tuple[Model, ...] = ("bicubic", "paper", "matched", "lmmse")


def figure_of(observers: list[Observer], noises_dn: list[float]) -> Figure:
    return curves_figure(
        [
            of_two_zooms(model=model, observer=observer, noise_dn=noise_dn)
            for model in MODELS
            for observer in observers
            for noise_dn in noises_dn
        ],
        "noise_dn",
    )


@pytest.mark.slow
@pytest.mark.parametrize("observers", [["npw"], ["npw", "hotelling", "cho"]])
@pytest.mark.parametrize("noises_dn", [[2.0], [2.125, 4.25, 8.5, 17.75, 35.25, 123456.0]])
def test_the_legend_lies_within_the_figure_and_below_the_panels(
    observers: list[Observer], noises_dn: list[float]
) -> None:
    figure = figure_of(observers, noises_dn)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert figure.bbox.x0 <= box.x0
    assert box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0
    panel = figure.axes[0].get_tightbbox()
    assert panel is not None
    assert box.y1 <= panel.y0
    # Every model and every noise has its entry.
    assert len(legend.get_texts()) == len(MODELS) + len(noises_dn)
    # The panels keep most of the height.
    assert figure.axes[0].get_window_extent().height > 0.4 * figure.bbox.height
