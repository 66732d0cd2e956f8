"""A limit that was predicted beside the one shown: each loss has its name."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from analysis.changes import (
    ChangeOptions,
    ChangeSummary,
    LimitCurve,
    describe_prediction,
    find_changes,
)
from analysis.changes.comparison import Comparison
from analysis.changes.detection import LimitMaps, detection_levels
from analysis.changes.matching import Smoothing, WhiteNoiseGain, smoothing_for
from analysis.changes.prediction import ExpectedFilters, meet
from analysis.detectability import (
    DetectionTask,
    GaussianSignal,
    d_prime_curves,
    expected_limits,
)
from analysis.detection_limits import PredictedLimit
from benchmarks.truth.lenses import gaussian
from benchmarks.truth.pairs import Development, PairPose, pair_of, scene
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import WHITE, comparison, smoothed_noise

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
    curves = d_prime_curves([pair(1.0)[0]], GaussianPsf(sigma_px=0.9), task)
    return expected_limits(curves.curves[0])


def shown(gain: float, predicted: LimitCurve) -> ChangeSummary:
    psf = GaussianPsf(sigma_px=0.9)
    return find_changes(*pair(gain), psf, ChangeOptions(expected=predicted)).summary


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
