"""Brackets merged into one image, against photographs with a response of one's own."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames
from acquisition.bracket import MergedBracket, _fit_noise_line, merge_bracket

BLACK_DN, TOP_DN = 64.0, 4095
GAIN_E_PER_DN, READ_NOISE_E = 5.0, 12.0
FRAMES = 10


def exposed(
    light_dn: NDArray[np.float64],
    ratio: float,
    rng: np.random.Generator,
    *,
    full_well_e: float = 30_000.0,
    black_dn: float = BLACK_DN,
) -> AveragedFrames:
    """Average FRAMES frames; ``light_dn`` is at the exposure of ratio 1, without black."""
    electrons = light_dn * ratio * GAIN_E_PER_DN
    frames = []
    for _ in range(FRAMES):
        collected = np.minimum(rng.poisson(electrons), full_well_e)
        collected = collected + READ_NOISE_E * rng.standard_normal(electrons.shape)
        frames.append(np.clip(np.rint(black_dn + collected / GAIN_E_PER_DN), 0, TOP_DN))
    return averaged_of(np.stack(frames))


def averaged_of(frames: NDArray[np.float64]) -> AveragedFrames:
    """The average of a stack of frames, shape ``(frames, rows, cols)``."""
    is_saturated = np.asarray((frames >= TOP_DN).any(axis=0))
    return AveragedFrames(
        mean_dn=frames.mean(axis=0).astype(np.float32),
        variance_dn2=frames.var(axis=0, ddof=1).astype(np.float32),
        frames_used=len(frames),
        incomplete_frames=0,
        resent_packets=0,
        saturated_pixels=int(is_saturated.sum()),
        min_dn=int(frames.min()),
        max_dn=int(frames.max()),
        first_timestamp_ns=1,
        last_timestamp_ns=2,
        is_saturated=is_saturated,
    )


SHORTEST_US = 9000.0
RATIOS = (1.0, 8.0, 64.0, 512.0)
DARK_DN2 = (READ_NOISE_E / GAIN_E_PER_DN) ** 2 + 1 / 12


def merged(averages: list[AveragedFrames], ratios: tuple[float, ...] = RATIOS) -> MergedBracket:
    return merge_bracket(
        [SHORTEST_US * ratio for ratio in ratios],
        averages,
        black_level_dn=BLACK_DN,
        max_level_dn=TOP_DN,
    )


def light_of(bracket: MergedBracket) -> NDArray[np.float64]:
    return bracket.averaged.mean_dn.astype(np.float64) - BLACK_DN


def error_of(bracket: MergedBracket) -> NDArray[np.float64]:
    averaged = bracket.averaged
    return np.sqrt(averaged.variance_dn2.astype(np.float64) / averaged.frames_used)


def expected(light_dn: NDArray[np.float64], ratio: float) -> AveragedFrames:
    """Means and variances of the camera model themselves, without scatter."""
    level = np.minimum(BLACK_DN + light_dn * ratio, TOP_DN)
    variance = DARK_DN2 + (level - BLACK_DN) / GAIN_E_PER_DN
    is_saturated = level >= TOP_DN
    return AveragedFrames(
        mean_dn=level.astype(np.float32),
        variance_dn2=np.where(is_saturated, 0.0, variance).astype(np.float32),
        frames_used=FRAMES,
        incomplete_frames=0,
        resent_packets=0,
        saturated_pixels=int(is_saturated.sum()),
        min_dn=int(level.min()),
        max_dn=int(level.max()),
        first_timestamp_ns=1,
        last_timestamp_ns=2,
        is_saturated=is_saturated,
    )


def test_light_and_variance_are_those_of_the_weighted_mean_in_closed_form() -> None:
    light = np.geomspace(0.3, 3000.0, 2000).reshape(40, 50)
    bracket = merged([expected(light, ratio) for ratio in RATIOS])
    assert light_of(bracket) == pytest.approx(light, rel=2e-5)  # float32 at the black level
    # 1 / sum(N t^2 / v) over the exposures below the top by four deviations of a frame
    variances = [DARK_DN2 + light * ratio / GAIN_E_PER_DN for ratio in RATIOS]
    counts = [
        light * ratio + 4 * np.sqrt(v) < TOP_DN - BLACK_DN
        for ratio, v in zip(RATIOS, variances, strict=True)
    ]
    information = sum(
        count * FRAMES * ratio**2 / v
        for count, ratio, v in zip(counts, RATIOS, variances, strict=True)
    )
    assert error_of(bracket) == pytest.approx(1 / np.sqrt(information), rel=1e-3)
    np.testing.assert_array_equal(bracket.exposures_used, np.sum(counts, axis=0))


def test_a_scene_of_ten_thousand_to_one_is_right_with_the_stated_errors() -> None:
    rng = np.random.default_rng(7)
    light = np.repeat(np.geomspace(0.27, 2700.0, 30)[:, np.newaxis], 100, axis=1)
    bracket = merged([exposed(light, ratio, rng) for ratio in RATIOS])
    pulls = (light_of(bracket) - light) / error_of(bracket)
    assert (bracket.exposures_used > 0).all()
    # 3000 intervals: three binomial deviations of 95 % are 1.2 %.
    assert np.mean(np.abs(pulls) < 1.96) == pytest.approx(0.95, abs=0.013)
    # 30 means of 100 pixels each: five standard errors.
    assert np.abs(pulls.mean(axis=1)).max() < 0.5
    steps = light_of(bracket).mean(axis=1) / light[:, 0]
    assert np.abs(steps - 1).max() < 0.005


def test_what_saturates_in_every_exposure_is_at_the_largest_level_and_not_valid() -> None:
    light = np.full((40, 50), 100.0)
    light[:10] = 10_000.0
    rng = np.random.default_rng(1)
    bracket = merged([exposed(light, ratio, rng) for ratio in RATIOS[:2]], RATIOS[:2])
    assert (bracket.exposures_used[:10] == 0).all()
    assert (bracket.exposures_used[10:] == 2).all()
    assert (bracket.averaged.mean_dn[:10] == TOP_DN).all()
    assert bracket.averaged.saturated_pixels == 500
    assert [one.saturated_pixels for one in bracket.exposures] == [500, 500]
    assert [one.used_pixels for one in bracket.exposures] == [1500, 1500]


def test_a_full_well_below_the_largest_level_is_seen() -> None:
    light = np.repeat(np.geomspace(20.0, 2700.0, 30)[:, np.newaxis], 100, axis=1)
    rng = np.random.default_rng(2)
    averages = [exposed(light, ratio, rng, full_well_e=17_000.0) for ratio in RATIOS[:2]]
    assert averages[1].saturated_pixels == 0
    bracket = merged(averages, RATIOS[:2])
    pulls = (light_of(bracket) - light) / error_of(bracket)
    assert np.abs(pulls.mean(axis=1)).max() < 0.5  # as above; without this, some are at 100


def test_a_pixel_that_any_frame_saw_saturated_does_not_count_there() -> None:
    light = np.full((40, 50), 100.0)
    averages = [expected(light, ratio) for ratio in RATIOS[:2]]
    blinked = np.zeros(light.shape, np.bool_)
    blinked[3, 4] = True
    averages[1] = replace(averages[1], is_saturated=blinked)
    used = merged(averages, RATIOS[:2]).exposures_used
    assert used[3, 4] == 1
    assert np.count_nonzero(used == 1) == 1


def test_levels_cut_off_at_zero_are_not_valid() -> None:
    light = np.zeros((40, 50))
    light[20:] = 500.0
    rng = np.random.default_rng(3)
    averages = [exposed(light, ratio, rng, black_dn=0.0) for ratio in (1.0, 4.0)]
    bracket = merge_bracket([100.0, 400.0], averages, black_level_dn=0.0, max_level_dn=TOP_DN)
    assert (bracket.exposures_used[:20] == 0).all()
    assert (bracket.exposures_used[20:] == 2).all()
    assert bracket.averaged.saturated_pixels == 0
    assert bracket.averaged.mean_dn[:20].max() < 1.0


def test_exposures_that_disagree_on_the_light_tell_by_how_much() -> None:
    light = np.full((40, 50), 300.0)
    bracket = merged([expected(light, 1.0), expected(1.04 * light, 8.0)], RATIOS[:2])
    assert bracket.exposures[0].light_ratio is None
    assert bracket.exposures[1].light_ratio == pytest.approx(1.04, rel=1e-4)


def test_exposures_must_ascend() -> None:
    average = expected(np.full((4, 6), 100.0), 1.0)
    for exposures_us in ([100.0], [200.0, 100.0], [100.0, 100.0], [0.0, 100.0]):
        with pytest.raises(ValueError):
            merge_bracket(
                exposures_us,
                [average] * len(exposures_us),
                black_level_dn=BLACK_DN,
                max_level_dn=TOP_DN,
            )


def test_the_noise_line_is_that_of_the_camera() -> None:
    rng = np.random.default_rng(4)
    light = np.repeat(np.geomspace(1.0, 3000.0, 50)[:, np.newaxis], 200, axis=1)
    one = exposed(light, 1.0, rng)
    line = _fit_noise_line(
        [(one.mean_dn, one.variance_dn2)], black_level_dn=BLACK_DN, saturation_dn=TOP_DN
    )
    # 10 000 variances of 10 frames, about half of them dark: 0.7 % each way, times four.
    assert line.slope_dn == pytest.approx(1 / GAIN_E_PER_DN, rel=0.03)
    assert line.offset_dn2 == pytest.approx(DARK_DN2, rel=0.05)
