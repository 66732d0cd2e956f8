"""Two photographs in colour are compared in colour."""

from dataclasses import replace

import numpy as np
import pytest
import skimage.data
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from acquisition.photographs import luma_plane
from analysis.changes import (
    ChangeOptions,
    ChangeResult,
    FilterWidth,
    PairColours,
    changes_between,
    significance_threshold,
)
from analysis.changes._colour import SeenDifference, to_luma_red_blue, to_rgb
from analysis.changes._significance import as_significance, joint_share, norm_at

ByteImage = NDArray[np.uint8]
NOISE_DN = 3.0
LUMA = np.array([0.299, 0.587, 0.114])
PLACE = (130.0, 60.0)  # y, x: a plain part of the picture


def noisy(levels: NDArray[np.float64], rng: np.random.Generator) -> ByteImage:
    made = levels + rng.normal(0, NOISE_DN, levels.shape)
    return np.clip(made, 0, 255).round().astype(np.uint8)


def scene() -> NDArray[np.float64]:
    """A quarter of a picture, within the scale, so that no noise is cut off."""
    picture: ByteImage = skimage.data.astronaut()  # type: ignore[no-untyped-call]  # scikit-image
    return np.asarray(picture[120:376, :256] * 0.8 + 25.0)


def painted(change_rgb: tuple[float, float, float], sigma_px: float = 4.0) -> NDArray[np.float64]:
    y, x = np.mgrid[:256, :256]
    spot = np.exp(-((y - PLACE[0]) ** 2 + (x - PLACE[1]) ** 2) / (2 * sigma_px**2))
    return np.asarray(scene() + spot[..., None] * np.array(change_rgb))


def compared(
    before: ByteImage, after: ByteImage, options: ChangeOptions | None = None
) -> ChangeResult:
    colours = PairColours(reference_dn=before, followup_dn=after, white_dn=(255.0, 255.0))
    options = replace(options or ChangeOptions(), colours=colours, white_level_dn=(255.0, 255.0))
    return changes_between(luma_plane(before), luma_plane(after), None, options)


@pytest.mark.slow
def test_a_red_for_a_green_of_one_luma_is_a_change_of_colour() -> None:
    rng = np.random.default_rng(1)
    peak = 25.0
    change = (peak, -peak * LUMA[0] / LUMA[1], 0.0)
    before, after = noisy(scene(), rng), noisy(painted(change), rng)
    grey = changes_between(luma_plane(before), luma_plane(after))
    assert grey.summary.changes == ()
    found = compared(before, after).summary.changes
    assert len(found) == 1
    one = found[0]
    assert one.what == "colour"
    assert np.hypot(one.y_px - PLACE[0], one.x_px - PLACE[1]) < 1
    assert one.amplitude_rgb_dn is not None
    # 4 standard errors of a spot of 4 px in noise of 3 * sqrt(2) DN: 0.6 DN each.
    assert np.allclose(one.amplitude_rgb_dn, change, atol=2.4)
    assert abs(one.amplitude_dn) < 4 * one.amplitude_err_dn
    assert one.delta_e is not None
    assert 1 < one.delta_e < 20


@pytest.mark.slow
def test_what_is_brighter_is_brighter_in_all_channels() -> None:
    rng = np.random.default_rng(2)
    found = compared(noisy(scene(), rng), noisy(painted((15.0, 15.0, 15.0)), rng)).summary
    assert [one.what for one in found.changes] == ["brighter"]
    one = found.changes[0]
    assert one.amplitude_rgb_dn is not None
    assert np.allclose(one.amplitude_rgb_dn, 15.0, atol=2.4)
    assert one.amplitude_dn == pytest.approx(LUMA @ one.amplitude_rgb_dn)


@pytest.mark.slow
def test_noise_alone_is_no_change_of_colour() -> None:
    rng = np.random.default_rng(3)
    found = compared(noisy(scene(), rng), noisy(scene(), rng)).summary
    assert found.changed_px <= 1  # 0.05 are stated


@pytest.mark.slow
def test_the_light_of_each_channel_is_its_own() -> None:
    rng = np.random.default_rng(4)
    lit = scene() * np.array([0.85, 1.0, 0.9])
    found = compared(noisy(scene(), rng), noisy(lit, rng)).summary
    assert found.changed_px <= 1


@pytest.mark.slow
def test_grey_photographs_are_compared_as_before() -> None:
    rng = np.random.default_rng(5)
    before, after = (luma_plane(noisy(scene(), rng)) for _ in range(2))
    found = changes_between(before, after).summary
    assert all(one.amplitude_rgb_dn is None for one in found.changes)


@pytest.mark.slow
def test_levels_that_are_not_in_proportion_are_compared_in_grey() -> None:
    rng = np.random.default_rng(6)
    before = noisy(scene(), rng)
    after = noisy(255 * (scene() / 255) ** 1.6, rng)
    warnings = compared(before, after).summary.warnings
    assert any("compared in grey" in one for one in warnings)


def test_the_significance_of_three_planes_is_exceeded_as_often_as_that_of_one() -> None:
    lengths = np.array([0.5, 2.0, 4.0, 6.0])
    # Chi-squared with three degrees of freedom, by scipy.
    assert np.allclose(joint_share(lengths), chi2.sf(lengths**2, 3), rtol=1e-12)
    significance = np.asarray(as_significance(lengths), dtype=np.float64)
    assert np.allclose(2 * norm.sf(significance), chi2.sf(lengths**2, 3), rtol=2e-3)
    assert np.allclose(norm_at(significance), lengths, atol=1e-3)
    assert np.all(np.diff(as_significance(np.linspace(0.0, 3000.0, 9000))) > 0)


def test_white_noise_of_three_planes_exceeds_the_threshold_as_stated() -> None:
    width = FilterWidth(width_px=1.0, planes=3, spread_err=1e-9)
    threshold = significance_threshold(1e-3, (width,))
    planes = np.random.default_rng(7).normal(size=(3, 1000, 1000))
    count = np.count_nonzero(as_significance(np.sqrt((planes**2).sum(axis=0))) > threshold)
    assert count == pytest.approx(1000, abs=4 * 1000**0.5)  # Poisson


def test_luma_red_and_blue_hold_all_channels() -> None:
    rgb = np.random.default_rng(8).normal(size=(3, 5))
    assert np.allclose(to_rgb(to_luma_red_blue(rgb)), rgb)


def test_a_lit_colour_is_no_other_colour() -> None:
    colour = np.array([120.0, 60.0, 20.0])
    assert not SeenDifference.of(colour, 0.5 * colour, 255.0).is_of_colour
    other = np.array([60.0, 60.0 + 60.0 * LUMA[0] / LUMA[1], 20.0])
    assert SeenDifference.of(colour, other, 255.0).is_of_colour


@pytest.mark.slow
def test_the_limit_is_that_of_the_change_that_is_named() -> None:
    rng = np.random.default_rng(9)
    before, after = noisy(scene(), rng), noisy(scene(), rng)
    limits = {}
    for name, rgb in (("grey", (1.0, 1.0, 1.0)), ("red", (1.0, 0.0, 0.0))):
        found = compared(before, after, ChangeOptions(limit_rgb=rgb)).summary.detection_limit
        assert found is not None
        assert found.change_rgb == rgb
        limits[name] = found.mapped.median_dn
    # Three channels of equal, independent noise add as the root of three.
    assert limits["red"] / limits["grey"] == pytest.approx(3**0.5, rel=0.05)
