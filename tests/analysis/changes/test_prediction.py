"""What filters make of noise and of spots, and a predicted limit beside the one shown."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.changes import (
    ChangeOptions,
    ChangeSummary,
    ExpectedFilters,
    FilterWidth,
    LimitCurve,
    changes_between,
    describe_prediction,
    smoothing_for,
)
from analysis.changes._comparison import Comparison
from analysis.changes._levels import LimitMaps, detection_levels
from analysis.changes._prediction import meet
from analysis.changes.matching import KERNEL_RADIUS_PX, Smoothing, WhiteNoiseGain, white_noise_gain
from analysis.detectability import DetectionTask, GaussianSignal, curves_of_images, expected_limits
from analysis.detection_limits import PredictedLimit
from benchmarks.truth.lenses import gaussian
from benchmarks.truth.pairs import Development, PairPose, pair_of, scene
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import WHITE, comparison, smoothed_noise

ZOOMS = st.floats(1.0, 4.0)
BLURS = st.floats(-1.5, 1.5)


@given(zoom=ZOOMS, blur_px2=BLURS)
def test_the_narrowest_filter_lets_as_much_noise_through_as_in_a_comparison(
    zoom: float, blur_px2: float
) -> None:
    filters = ExpectedFilters(zoom=zoom, smoothing=smoothing_for(blur_px2))
    taps = np.zeros((2 * KERNEL_RADIUS_PX + 1,) * 2)
    taps[KERNEL_RADIUS_PX, KERNEL_RADIUS_PX] = 1.0
    gains = white_noise_gain(taps, filters.smoothing, zoom)
    narrowest = FilterWidth(width_px=filters.smoothing.target_px)
    assert filters.noise_gain(narrowest) == pytest.approx(gains.source + gains.target)


@pytest.mark.slow
@given(zoom=ZOOMS, blur_px2=BLURS)
def test_wider_filters_let_less_noise_through_and_count_as_strictly(
    zoom: float, blur_px2: float
) -> None:
    filters = ExpectedFilters(zoom=zoom, smoothing=smoothing_for(blur_px2))
    gains = [filters.noise_gain(width) for width in filters.widths]
    assert all(np.diff(gains) < 0)
    assert [width.allowance for width in filters.widths] == sorted(
        width.allowance for width in filters.widths
    )


def test_a_spot_in_white_noise_has_the_limit_of_the_closed_form() -> None:
    # Equal photographs: behind a first width of root 2 px noise has 1 / (4 pi), and a spot of 1 px
    # is a third as high, less what its mean distance from a pixel's centre takes.
    filters = ExpectedFilters(zoom=1.0, smoothing=Smoothing(source_px=1.0, target_px=1.0))
    by_hand = 3.0 * sqrt(1 / (4 * pi)) / (np.exp(-1 / 6 / 6) / 3)
    assert filters.limit_per_height(1.0, 3.0) == pytest.approx(by_hand, rel=1e-9)


def test_an_autocovariance_is_averaged_as_a_wider_gaussian_does() -> None:
    # White noise behind s is alike as exp(-d^2 / 4 s^2), and has 1 / 4 pi w^2 behind w.
    filters = ExpectedFilters(zoom=1.0, smoothing=Smoothing(source_px=1.3, target_px=1.3))
    lag = np.arange(-120, 121)
    alike = np.exp(-(np.add.outer(lag**2, lag**2)) / (4 * 1.3**2)) / (4 * pi * 1.3**2)
    for width in filters.widths:
        weights = filters.averaging(width, 120)
        assert weights.sum() == pytest.approx(1.0, abs=1e-3)
        # To 0.1 %: the sums stand for integrals.
        assert np.sum(weights * alike) == pytest.approx(1 / (4 * pi * width.width_px**2), rel=1e-3)


SHAPE = (192, 192)
PLAIN = Smoothing(source_px=1.0, target_px=1.0)
GAIN = 1 / (4 * pi)
SPOT_PX = 1.5
NOISE_DN = 2.0


def compared(sd_factor: float = 1.0, smoothing: Smoothing = PLAIN) -> Comparison:
    """White noise of 2 DN in both photographs; ``sd_factor`` times what it makes."""
    gains = WhiteNoiseGain(
        source=GAIN / smoothing.source_px**2, target=GAIN / smoothing.target_px**2
    )
    noise_dn2 = NOISE_DN**2 * (gains.source + gains.target)
    sd = sd_factor * sqrt(noise_dn2)
    noise = smoothed_noise(np.random.default_rng(5), SHAPE, smoothing.target_px) * sd
    scatter = replace(WHITE, gains=gains, noise_dn2=noise_dn2, white_dn2=noise_dn2)
    made = comparison(noise, sd, smoothing_px=smoothing.target_px)
    return replace(made, smoothing=smoothing, scatter=scatter)


def curve() -> LimitCurve:
    limit = ExpectedFilters(zoom=1.0, smoothing=PLAIN).limit_per_height(SPOT_PX, NOISE_DN)
    return LimitCurve(
        zoom=(1.0, 2.0),
        spot_sigma_px=(SPOT_PX, SPOT_PX),
        dn_per_height=(limit, limit),
        noise_dn=NOISE_DN,
    )


def met(found: Comparison, zoom: float = 1.0) -> PredictedLimit:
    levels = detection_levels(found, 1e-6)
    limit = meet(curve(), zoom, found, LimitMaps.of(found, levels, 5.0, 1.0))
    assert limit is not None
    return limit


def sources(limit: PredictedLimit) -> list[str]:
    return [line.rpartition("(")[2].rstrip(")") for line in limit.lost_to]


def test_white_noise_as_assumed_shows_what_was_predicted() -> None:
    limit = met(compared())
    # The wider levels measure their own scatter on few places.
    assert limit.ratio == pytest.approx(1.0, abs=0.03)
    assert limit.lost_to == ()
    assert all(factor == pytest.approx(1.0, abs=0.01) for factor in limit.factors.values())


def test_the_factors_make_the_ratio() -> None:
    found = compared(1.5)
    limit = met(replace(found, scatter=replace(found.scatter, structure_share=0.5)))
    assert np.prod(list(limit.factors.values())) == pytest.approx(limit.ratio, rel=1e-9)


def test_half_the_light_needs_twice_the_change() -> None:
    # Nothing but the gain differs: noise and filters are as they were.
    found = compared()
    gains = replace(found.scatter.gains, source=found.scatter.gains.source * 0.25)
    limit = met(replace(found, gain=0.5, scatter=replace(found.scatter, gains=gains)))
    assert limit.ratio == pytest.approx(2.0, rel=0.03)
    assert sources(limit) == ["light"]


def test_a_softer_follow_up_is_a_loss_by_focus() -> None:
    found = compared(smoothing=smoothing_for(2.0))
    limit = met(replace(found, kernel="both", extra_blur_px2=2.0, extra_blur_err_px2=0.05))
    assert limit.ratio > 1.15
    assert sources(limit) == ["focus"]
    assert "softer by 2.00 px^2" in limit.lost_to[0]


def test_noise_that_single_pixels_show_is_told_from_what_compression_leaves() -> None:
    louder = compared(2.0)
    noise_dn2 = 4 * louder.scatter.noise_dn2
    white = replace(louder.scatter, noise_dn2=noise_dn2, white_dn2=noise_dn2)
    assert sources(met(replace(louder, scatter=white))) == ["light"]
    correlated = replace(white, white_dn2=noise_dn2 / 10)
    assert sources(met(replace(louder, scatter=correlated))) == ["texture"]


def test_structure_along_gradients_is_registration_and_other_structure_texture() -> None:
    found = compared(2.0)
    structured = replace(found.scatter, structure_share=0.75)
    assert sources(met(replace(found, scatter=structured))) == ["texture"]
    displaced = replace(structured, displaced=0.7)
    assert sources(met(replace(found, scatter=displaced))) == ["registration"]


def test_nothing_is_said_beyond_the_curve() -> None:
    found = compared()
    limits = LimitMaps.of(found, detection_levels(found, 1e-6), 5.0, 1.0)
    assert meet(curve(), 2.2, found, limits) is None
    never = replace(curve(), dn_per_height=(np.inf, np.inf))
    assert meet(never, 1.5, found, limits) is None


def pair(gain: float, noise_dn: float = 1.0) -> tuple[FloatArray, FloatArray]:
    frame = (200, 260)
    camera = gaussian(0.9, has_pixel=False)
    pose = PairPose(zoom=1.5, tilt_deg=4.0, bearing_deg=30.0)
    made = pair_of(scene("texture", frame, 3, contrast_dn=20.0), frame, pose, (camera, camera))
    reference = Development(noise_dn=noise_dn).of(made.reference_dn, 1)
    return reference, Development(noise_dn=noise_dn, gain=gain).of(made.followup_dn, 2)


@pytest.fixture(scope="module")
def predicted() -> LimitCurve:
    """From the reference alone."""
    task = DetectionTask(
        signal=GaussianSignal(sigma_px=2.0),
        noises_dn=(1.0,),
        zooms=(1.0, 1.25, 1.5, 2.0),
        models=("matched",),
        observers=("changes",),
        reference_zoom=1.0,
        window_px=25,
    )
    curves = curves_of_images([pair(1.0)[0]], GaussianPsf(sigma_px=0.9), task)
    return expected_limits(curves.curves[0])


def shown(gain: float, predicted: LimitCurve) -> ChangeSummary:
    psf = GaussianPsf(sigma_px=0.9)
    return changes_between(*pair(gain), psf, ChangeOptions(expected=predicted)).summary


@pytest.mark.slow
def test_a_rendered_pair_shows_the_limit_that_its_reference_predicts(predicted: LimitCurve) -> None:
    """By a renderer that shares nothing with the capture model."""
    summary = shown(1.0, predicted)
    assert summary.detection_limit is not None
    limit = summary.detection_limit.predicted
    assert limit is not None
    assert limit.ratio == pytest.approx(1.0, abs=0.1)  # 60 such pairs: 0.05 in nine of ten
    assert limit.lost_to == ()
    said = describe_prediction(summary)
    assert said is not None
    assert "were predicted" in said


@pytest.mark.slow
def test_a_rendered_pair_in_half_the_light_says_so(predicted: LimitCurve) -> None:
    summary = shown(0.5, predicted)
    assert summary.detection_limit is not None
    limit = summary.detection_limit.predicted
    assert limit is not None
    assert sources(limit) == ["light"]
    said = describe_prediction(summary)
    assert said is not None
    assert "0.50 times the light" in said
