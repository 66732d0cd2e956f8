"""Changes on photographs of a scene known in closed form; the analysis resamples, these do not."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from acquisition.bench import load_bench
from analysis.changes import (
    Change,
    ChangeOptions,
    ChangeResult,
    FilterWidth,
    changes_between,
    read_changes,
    significance_threshold,
)
from analysis.changes._filter import ChangeMasks, change_warnings
from analysis.detection_limits import level_text
from analysis.errors import AnalysisError, OverlapError
from analysis.reports import plot_changes
from analysis.results_file import write_results
from benchmarks.scoring import roc_of
from calibration.registration._distorted_pose import DistortedPose
from simulation import GaussianPsf
from simulation.arrays import BoolArray, FloatArray
from simulation.capture_noise import CaptureNoise
from standoff.shipped_configs import shipped_config
from tests.analysis.blob_scene import blobs, photograph, pose_matrix
from tests.analysis.changed_scenes import bench_noise, bench_pair, bench_psf, far_pose
from tests.analysis.changes.compared_fields import change_at
from tests.analysis.changes.test_change_list import flat_thing
from tests.analysis.random_poses import bench_truth

NEAR, FAR, ZOOM, PSF_PX, SHIFT_PX = (270, 330), (170, 210), 1.5, 0.9, 2.3
PSF = GaussianPsf(sigma_x_px=PSF_PX, sigma_y_px=PSF_PX)
NOISE = CaptureNoise(gain_e_per_dn=60.0, read_noise_e=10.0, black_level_dn=0.0)
MATRIX = pose_matrix(NEAR, FAR, ZOOM, SHIFT_PX)
LIGHT = 1.05 + 0.1 * np.linspace(-1, 1, FAR[1])[None, :]


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    reference: FloatArray
    followup: FloatArray
    truth: FloatArray


@lru_cache
def pair(seed: int, contrast_dn: float) -> Pair:
    """Reference, and a follow-up from 1.5 times as far in other light, with sixteen changes."""
    rng = np.random.default_rng(seed)
    scene = blobs(seed, 5000, 240.0)
    places = np.arange(-60.0, 61.0, 40.0)
    change = np.array([[y, x, 2.0, contrast_dn] for y in places for x in places])
    noiseless = (
        photograph(scene, NEAR, 1.0, PSF_PX),
        photograph(np.vstack([scene, change]), FAR, ZOOM, PSF_PX, SHIFT_PX) * LIGHT,
    )
    noisy = [
        image + np.sqrt(NOISE.variance_dn2(image)) * rng.standard_normal(image.shape)
        for image in noiseless
    ]
    truth = photograph(change, FAR, ZOOM, PSF_PX, SHIFT_PX) - 120.0
    return Pair(reference=noisy[0], followup=noisy[1], truth=truth)


def posed(
    matrix: FloatArray,
    noise: CaptureNoise | None = NOISE,
    near: tuple[int, int] = NEAR,
    far: tuple[int, int] = FAR,
) -> ChangeOptions:
    pose = DistortedPose(matrix=matrix, k1=0.0, reference_shape=near, followup_shape=far)
    return ChangeOptions(pose=pose, noise=noise)


@lru_cache
def found(one: Pair, noise: CaptureNoise | None = NOISE) -> ChangeResult:
    return changes_between(one.reference, one.followup, PSF, posed(MATRIX, noise))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [NOISE, None])
def test_nothing_is_flagged_where_only_pose_and_light_changed(noise: CaptureNoise | None) -> None:
    result = found(pair(1, 0.0), noise)
    # 0.05 pixels a frame are allowed.
    assert not result.is_change.any()
    scatter = result.difference_dn[result.valid] / np.sqrt(result.variance_dn2[result.valid])
    assert scatter.std() == pytest.approx(1.0, abs=0.05)
    assert result.summary.gain == pytest.approx(1.05, abs=0.01)
    assert abs(result.summary.extra_blur_px2) < 4 * result.summary.extra_blur_err_px2 < 0.1
    assert result.summary.kernel == "calibrated"
    # The plain difference of the same pair is far beyond its noise.
    noise_dn = np.sqrt(np.median(result.variance_dn2[result.valid]))
    assert result.plain_difference_dn[result.valid].std() > 1.5 * noise_dn


@pytest.mark.parametrize(("contrast_dn", "noise_dn"), [(25.0, 0.5), (-25.0, 3.0), (120.0, 1.0)])
def test_a_disc_is_listed_at_its_middle_with_its_own_area(
    contrast_dn: float, noise_dn: float
) -> None:
    disc, rng = flat_thing("disc", (45.3, 60.8), 28.0, 1.2), np.random.default_rng(4)
    ground = 120 + 600 * (gaussian_filter(rng.random(disc.shape), 3.0) - 0.5)  # of 15 DN
    before = ground + rng.normal(0, noise_dn, disc.shape)
    after = ground + contrast_dn * disc + rng.normal(0, noise_dn, disc.shape)
    options = posed(np.eye(3), None, disc.shape, disc.shape)
    (change,) = changes_between(before, after, None, options).summary.changes
    assert (change.y_px, change.x_px) == pytest.approx((45.3, 60.8), abs=0.3)
    assert change.area_px == pytest.approx(np.pi * 14**2, rel=0.05)


@pytest.mark.slow
def test_the_parts_of_the_plain_difference_add_up() -> None:
    result = found(pair(2, 25.0))
    np.testing.assert_allclose(
        result.plain_difference_dn,
        result.difference_dn + result.pose_difference_dn,
        atol=1e-4,  # levels of 250 in float32
    )


@pytest.mark.slow
def test_a_change_is_found_where_it_is_and_nowhere_else() -> None:
    one = pair(2, 25.0)
    result = found(one)
    core = result.valid & (one.truth > 0.5 * one.truth.max())
    assert result.is_change[core].mean() > 0.98
    clear = result.valid & (gaussian_filter(one.truth, 1.0) < 0.005 * one.truth.max())
    assert not result.is_change[clear].any()
    assert "px changed" in plot_changes(result).axes[0].get_title()


@pytest.mark.slow
def test_false_positives_fall_five_fold_at_equal_true_positives() -> None:
    """Faint changes, and a plain difference that gets the same light fit and smoothing."""
    plain_false, false = 0, 0
    for seed in range(3, 5):
        one = pair(seed, 7.0)
        result = found(one)
        core = result.valid & (one.truth > 0.5 * one.truth.max())
        clear = result.valid & (gaussian_filter(one.truth, 1.0) < 0.005 * one.truth.max())
        plain = np.abs(result.plain_difference_dn)
        significance = np.abs(result.significance)
        plain_false += int((plain[clear] >= np.quantile(plain[core], 0.2)).sum())
        false += int((significance[clear] >= np.quantile(significance[core], 0.2)).sum())
    assert plain_false >= 5 * max(false, 1), (plain_false, false)


@pytest.mark.slow
def test_a_softer_follow_up_is_compared_and_its_focus_said() -> None:
    rng = np.random.default_rng(8)
    scene = blobs(1, 5000, 240.0)
    soft = photograph(scene, FAR, ZOOM, float(np.hypot(PSF_PX, 0.7)), SHIFT_PX)
    soft += np.sqrt(NOISE.variance_dn2(soft)) * rng.standard_normal(soft.shape)
    result = changes_between(pair(1, 0.0).reference, soft, PSF, posed(MATRIX))
    # 0.05 pixels a frame are allowed.
    assert not result.is_change.any()
    # A variance of 0.7^2 was added; a standard error is about 0.02.
    assert result.summary.extra_blur_px2 == pytest.approx(
        0.7**2, abs=4 * result.summary.extra_blur_err_px2
    )
    assert result.summary.kernel == "both"
    assert any("focus has changed" in warning for warning in result.summary.warnings)


def test_images_that_share_nothing_are_refused() -> None:
    one = pair(1, 0.0)
    away = MATRIX.copy()
    away[0, 2] += 320.0
    with pytest.raises(OverlapError) as refused:
        changes_between(one.reference, one.followup, PSF, posed(away))
    assert refused.value.shared_px < 1000


@pytest.mark.slow
def test_on_the_bench_false_positives_fall_and_the_pose_alone_flags_nothing() -> None:
    """Spots that are in the scene, zoom 1.5; benchmarks/studies/changes.py has more of them."""
    truth = bench_truth(load_bench(shipped_config("demo_bench.toml")), 260, 194)
    psf = bench_psf(truth)
    plain_false, false, changed = 0, 0, 0
    for contrast in (0.0, 0.01):
        one = bench_pair(
            truth,
            "gravel",
            far_pose(truth, 1.5, tilt_x_deg=3.0, roll_deg=2.0),
            contrast=contrast,
            sigma_mm=1.2,
            pitch_mm=16.0,
            seed=1,
        )
        options = ChangeOptions(noise=bench_noise(truth))
        result = changes_between(one.reference, one.followup, psf, options)
        if not contrast:
            # 0.05 pixels a frame are allowed.
            assert not result.is_change.any()
            continue
        core = result.valid & (one.change > 0.5 * one.change.max())
        clear = result.valid & (gaussian_filter(one.change, 1.0) < 0.005 * one.change.max())
        plain = np.abs(result.plain_difference_dn)
        significance = np.abs(result.significance)
        plain_false = roc_of(plain[core], plain[clear]).false_at(0.8)
        false = roc_of(significance[core], significance[clear]).false_at(0.8)
        changed = int(core.sum())
    assert changed > 200
    assert plain_false >= 5 * max(false, 1), (plain_false, false)


@pytest.mark.slow
def test_a_lens_that_distorts_flags_nothing_either() -> None:
    """1 % of barrel; aligned by a homography alone, some tens of pixels are flagged.

    The fitted kernel takes part of the wrong positions, and their scatter the rest.
    """
    config = load_bench(shipped_config("demo_bench.toml"))
    assert config.simulated is not None
    simulated = config.simulated.model_copy(update={"k1": -0.01})
    truth = bench_truth(config.model_copy(update={"simulated": simulated}), 390, 290)
    psf, noise = bench_psf(truth), bench_noise(truth)
    one = bench_pair(
        truth,
        "coins",
        far_pose(truth, 1.3, tilt_x_deg=4.0, roll_deg=2.0),
        contrast=0.0,
        sigma_mm=1.0,
        pitch_mm=30.0,
        seed=1,
    )
    result = changes_between(one.reference, one.followup, psf, ChangeOptions(noise=noise))
    assert result.summary.distortion_k1 == pytest.approx(-0.01, abs=3e-4)
    # 0.05 pixels a frame are allowed, and come in clusters.
    assert result.is_change.sum() <= 4
    frame = one.reference.shape[0], one.reference.shape[1]
    bent = changes_between(
        one.reference, one.followup, psf, posed(one.matrix, noise, near=frame, far=frame)
    )
    assert (bent.is_change | bent.is_moved).sum() > 20  # shifted edges, most of them
    assert bent.summary.registration_err_px > 3 * result.summary.registration_err_px


def test_a_pose_whose_horizon_is_in_the_frame_is_refused() -> None:
    one = pair(1, 0.0)
    tilted = MATRIX.copy()
    tilted[2, 0] = -0.01
    with pytest.raises(AnalysisError) as refused:
        changes_between(one.reference, one.followup, PSF, posed(tilted))
    assert not isinstance(refused.value, OverlapError)


@pytest.mark.slow
def test_the_figures_come_back_from_their_file_and_print_in_a_line(tmp_path: Path) -> None:
    result = found(pair(1, 0.0), None)
    path = tmp_path / "changes.json"
    named = result.summary.model_copy(update={"reference": "a.tif", "followup": "b.tif"})
    write_results(path, named)
    assert read_changes(path) == named
    assert list(json.loads(path.read_text())) == [
        *("schema", "reference", "followup", "homography", "distortion_k1", "distortion_k1_err"),
        *("zoom", "changed_px", "compared_px", "threshold_sd", "false_alarms_px", "gain"),
        *("gain_err", "extra_blur_px2", "extra_blur_err_px2", "noise_factor", "is_noise_known"),
        *("registration_err_px", "width_err_px2", "psf_form", "changes", "moved", "moved_px"),
        *("least_dn", "below_least", "false_discovery_rate", "saturated_px", "kernel"),
        *("detection_limit", "frame_px", "parallax", "warnings", "provenance"),
    ]
    px = int(result.valid.sum())
    assert repr(result).startswith(f"<ChangeResult: 0 changes, 0 of {px} px beyond ")
    # Where nothing tells the blur, its error is infinite: null in the file.
    write_results(path, named.model_copy(update={"extra_blur_err_px2": np.inf}))
    assert json.loads(path.read_text())["extra_blur_err_px2"] is None
    assert read_changes(path).extra_blur_err_px2 == np.inf


def test_a_rate_that_every_pixel_reaches_has_no_threshold() -> None:
    own = (FilterWidth(width_px=1.0),)
    assert significance_threshold(1.0, own) == 0.0
    # Above the 1.96 of a spread that is known, as its own error widens the tails.
    assert 1.96 < significance_threshold(0.05, own) < 2.1


SHAPE = (200, 300)
NONE = np.zeros(SHAPE, dtype=np.bool_)


def block(rows: slice, cols: slice) -> BoolArray:
    mask = NONE.copy()
    mask[rows, cols] = True
    return mask


INNER = block(slice(10, 190), slice(10, 290))


def masks(
    is_change: BoolArray = NONE,
    valid: BoolArray = INNER,
    clipped: BoolArray = NONE,
    reference_clipped: BoolArray = NONE,
) -> ChangeMasks:
    return ChangeMasks(
        is_change=is_change & valid,
        valid=valid,
        clipped=clipped,
        reference_clipped=reference_clipped,
    )


def change(y_px: float, x_px: float, amplitude_dn: float) -> Change:
    return change_at(x_px, y_px, amplitude_dn)


def test_an_ordinary_change_is_not_doubted() -> None:
    inside = block(slice(80, 90), slice(100, 112))
    at_border = block(slice(11, 20), slice(100, 112))
    for mask in (NONE, inside, at_border):
        assert change_warnings([change(85, 106, 9.0)], masks(mask)) == ()


def test_a_strip_along_a_border_is_named_with_its_side() -> None:
    (left,) = change_warnings([], masks(block(slice(10, 190), slice(10, 13))))
    assert "lie along the left of" in left
    (two,) = change_warnings(
        [], masks(block(slice(10, 14), slice(10, 290)) | block(slice(12, 188), slice(287, 290)))
    )
    assert "lie along the top and right of" in two


def test_changes_beside_a_masked_hole_are_no_border() -> None:
    hole = block(slice(60, 140), slice(80, 200))
    ring = block(slice(57, 143), slice(77, 203)) & ~hole
    assert change_warnings([], masks(ring, valid=INNER & ~hole)) == ()


def test_a_highlight_in_one_photograph_alone_is_likely_gloss() -> None:
    gloss = block(slice(50, 58), slice(60, 70))
    hidden = INNER & ~block(slice(45, 63), slice(55, 75))
    (said,) = change_warnings([], masks(valid=hidden, clipped=gloss))
    assert "1 in the follow-up alone" in said
    assert "gloss" in said
    (said,) = change_warnings([], masks(valid=hidden, reference_clipped=gloss))
    assert "1 in the reference alone" in said
    # What both show clipped is part of the scene.
    assert change_warnings([], masks(clipped=gloss, reference_clipped=np.roll(gloss, 2))) == ()


def test_changes_on_the_rim_of_a_highlight_are_counted() -> None:
    gloss = block(slice(50, 58), slice(60, 70))
    changes = [change(54, 75, 9.0), change(54, 76, -9.0), change(150, 200, 9.0)]
    (said,) = change_warnings(changes, masks(clipped=gloss))
    assert "1 of 3 changes lie beside clipped pixels" in said


def test_a_large_overexposed_part_is_no_gloss() -> None:
    assert change_warnings([], masks(clipped=block(slice(0, 100), slice(0, 200)))) == ()


def test_a_small_overlap_is_said_with_its_share() -> None:
    (said,) = change_warnings([], masks(valid=block(slice(0, 100), slice(0, 120))))
    assert "only 20 % of the follow-up" in said


def test_no_overlap_at_all_has_a_sentence_too() -> None:
    assert len(change_warnings([], masks(valid=NONE))) == 1


@pytest.mark.parametrize(
    ("level_dn", "text"), [(4.68, "4.7"), (102.4, "100"), (1380.0, "1400"), (0.034, "0.034")]
)
def test_levels_have_two_digits_and_no_exponent(level_dn: float, text: str) -> None:
    assert level_text(level_dn) == text
