from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from acquisition.bench import load_bench
from analysis.pose import PoseTracker, pose_quality
from standoff.shipped_configs import shipped_config
from tests.analysis.detectability.test_curves import curve
from tests.analysis.random_poses import bench_truth, posed_frames, reference_frame
from tests.calibration.registration.test_tracking import pose, scene, seen_from

MIN_D_PRIME = 2.4


def tracker(min_d_prime: float = MIN_D_PRIME) -> PoseTracker:
    return PoseTracker(scene(), curve(), min_d_prime)


@pytest.mark.slow
def test_the_first_frame_is_searched_and_the_next_ones_are_followed() -> None:
    followed = tracker()
    first = followed.update(seen_from(scene(), pose(1.1)))
    second = followed.update(seen_from(scene(), pose(1.12, 0.02, 3.0)))
    assert (first.anchored, second.anchored) == (True, False)
    assert (followed.frames, followed.anchors) == (2, 1)
    assert second.zoom == pytest.approx(1.12, rel=0.005)
    followed.reset()
    assert followed.update(seen_from(scene(), pose(1.12))).anchored


@pytest.mark.parametrize(
    ("zoom", "is_accepted", "reason"), [(1.1, True, "good: d′ 3.3"), (1.6, False, "too far: ")]
)
def test_the_verdict_has_a_margin_and_a_reason(zoom: float, is_accepted: bool, reason: str) -> None:
    verdict = tracker().update(seen_from(scene(), pose(zoom)))
    assert verdict.accepted is is_accepted
    assert verdict.reason.startswith(reason)
    expected = float(curve().d_prime_at(zoom))
    assert verdict.dprime == pytest.approx(expected, rel=0.02)
    assert verdict.margin is not None
    assert verdict.margin == pytest.approx(expected / MIN_D_PRIME - 1, abs=0.02)


def test_an_oblique_view_names_the_side_that_is_too_coarse() -> None:
    # Towards the right the reference is stretched: dx / du grows with 1 / (1 + lean u)^2.
    verdict = tracker(3.2).update(seen_from(scene(), pose(1.1, lean=-8e-4)))
    assert not verdict.accepted
    assert verdict.reason.startswith("too oblique: ")
    assert "right" in verdict.reason


@pytest.mark.slow
def test_what_is_lost_is_told_and_found_again() -> None:
    followed = tracker()
    followed.update(seen_from(scene(), pose(1.1)))
    lost = followed.update(scene(7))
    assert not lost.accepted
    assert lost.dprime is None
    assert lost.reason.startswith("the reference is not recognised: ")
    again = followed.update(seen_from(scene(), pose(1.1)))
    assert again.accepted
    assert again.anchored
    assert followed.anchors == 3


def test_a_frame_of_another_size_is_searched_as_a_whole() -> None:
    followed = tracker()
    followed.update(seen_from(scene(), pose(1.1)))
    assert followed.update(seen_from(scene(), pose(1.1))[:200]).anchored


def test_a_threshold_above_the_curve_is_told_to_be_beyond_any_pose() -> None:
    verdict = tracker(40.0).update(seen_from(scene(), pose(1.05)))
    assert not verdict.accepted
    assert verdict.reason.startswith("no pose is good enough with this curve: d′ ")
    assert verdict.reason.endswith("threshold 40")


def test_a_threshold_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError):
        tracker(0.0)


@pytest.mark.slow
def test_verdicts_at_random_poses_agree_with_the_bench() -> None:
    """Those outside 5 % of the threshold; benchmarks/speed/pose_tracking.py has 200 of them."""
    truth = bench_truth(load_bench(shipped_config("demo_bench.toml")), 260, 194)
    followed = PoseTracker(reference_frame(truth, "coins", 0), curve(), MIN_D_PRIME)
    decided = right = 0
    for frame in posed_frames(truth, "coins", 10, 3):
        verdict = followed.update(frame.image_dn)
        size = frame.image_dn.shape[1], frame.image_dn.shape[0]
        true = pose_quality(frame.matrix, size, size, curve(), MIN_D_PRIME)
        if abs(true.decisive_d_prime / MIN_D_PRIME - 1) > 0.05:
            decided += 1
            right += verdict.accepted == true.is_accepted
    assert decided >= 6
    assert right == decided


@pytest.mark.slow
def test_the_same_frames_give_the_same_verdicts() -> None:
    frames = [seen_from(scene(), pose(1.1, 0.01 * k)) for k in range(3)]
    runs = []
    for _ in range(2):
        followed = tracker()
        runs.append([followed.update(frame).dprime for frame in frames])
    np.testing.assert_array_equal(runs[0], runs[1])


@pytest.mark.slow
def test_it_says_while_it_searches_and_only_then(monkeypatch: pytest.MonkeyPatch) -> None:
    followed = tracker()
    seen: dict[str, bool] = {}

    def watched(name: str, of: Callable[..., Any]) -> None:
        def told(*arguments: Any) -> Any:
            seen[name] = followed.is_searching
            return of(*arguments)

        monkeypatch.setattr(followed._follower._reference, name, told)

    watched("anchored", followed._follower._reference.anchored)
    watched("followed", followed._follower._reference.followed)
    followed.update(seen_from(scene(), pose(1.1)))
    followed.update(seen_from(scene(), pose(1.1)))
    assert seen == {"anchored": True, "followed": False}
    followed.update(scene(7))  # not recognised
    assert not followed.is_searching
