"""What a want takes: closed forms, and sentences that name the cheapest way."""

from math import sqrt

import pytest

from analysis.study import PlanSize, Prediction, Want, WantName, next_step, studied_want

SIZE = PlanSize(frames=10, edges=24, photographs=2, run_s=600.0, frame_s=0.5)


def sigma(pixels: float, focus: float, value: float = 0.8) -> list[Prediction]:
    """Both widths, with standard errors by the pixels and the focus, relative."""
    variances = {
        "pixel noise of the edges": (pixels * value) ** 2,
        "focus from capture to capture": (focus * value) ** 2,
    }
    return [
        Prediction(quantity=name, value=value, variances=variances)  # type: ignore[arg-type]
        for name in ("sigma_x_px", "sigma_y_px")
    ]


def d_prime(scene: float, pixels: float = 0.001, noise: float = 0.0) -> list[Prediction]:
    """d' of 2 with relative standard errors."""
    return [
        Prediction(
            quantity="d_prime",
            value=2.0,
            variances={
                "pixel noise of the edges": (2 * pixels) ** 2,
                "focus from capture to capture": 0.0,
                "noise of the camera": (2 * noise) ** 2,
                "photographs of the scene": (2 * scene) ** 2,
            },
        )
    ]


def want(name: WantName, half_width: float) -> Want:
    return Want(name=name, half_width=half_width)


def test_half_the_error_takes_four_times_the_frames() -> None:
    predictions = sigma(0.01, 0.0)
    now = 1.959963984540054 * 0.01
    found = studied_want(want("sigma", now / 2), predictions, SIZE)
    assert found.predicted == pytest.approx(now)
    assert not found.reached
    assert found.needs.frames_per_capture == 40
    assert found.needs.edges == 96
    assert found.needs.session_runs == 4
    assert found.needs.photographs is None
    assert found.sentence.startswith("Average 40 frames a capture instead of 10: sigma is then")


def test_what_is_reached_needs_nothing() -> None:
    found = studied_want(want("sigma", 0.02), sigma(0.01, 0.0), SIZE)
    assert found.reached
    assert found.needs.model_dump(exclude_defaults=True) == {}
    assert "is enough" in found.sentence
    assert next_step([found], sigma(0.01, 0.0), SIZE).startswith("Run the plan")


def test_focus_bounds_what_frames_can_do() -> None:
    found = studied_want(want("sigma", 0.005), sigma(0.002, 0.01), SIZE)
    assert found.needs.frames_per_capture is None
    # (.002^2 + .01^2) / (.005 / 1.96)^2 = 15.98
    assert found.needs.session_runs == 16
    assert found.sentence.endswith("more frames alone reach 2 % at best, because of the focus.")


def test_photographs_are_the_cheapest_where_the_scene_is_what_is_not_known() -> None:
    found = studied_want(want("dprime", 0.05), d_prime(0.06), SIZE)
    # 2 x (.06 / (.05 / 1.96))^2 = 11.06, and a little for the pixels.
    assert found.needs.photographs == 12
    assert found.sentence == (
        "Take 10 more photographs of the scene: d' at zoom 1.5 is then known to 5 %; frames and "
        "edges hardly matter."
    )
    assert next_step([found], d_prime(0.06), SIZE) == found.sentence


def test_two_sources_that_are_both_too_large_shrink_together_in_the_least_time() -> None:
    predictions = d_prime(0.06, pixels=0.04)
    found = studied_want(want("dprime", 0.05), predictions, SIZE)
    needs = found.needs
    assert needs.is_together
    assert needs.session_runs is not None
    assert needs.photographs is not None

    def half_width(runs: int, photographs: int) -> float:
        return 1.959963984540054 * sqrt(0.04**2 / runs + 0.06**2 * 2 / photographs)

    def seconds(runs: int, photographs: int) -> float:
        return 600.0 * runs + 60.0 * photographs

    assert half_width(needs.session_runs, needs.photographs) <= 0.05
    enough = [
        seconds(runs, photographs)
        for runs in range(1, 60)
        for photographs in range(2, 300)
        if half_width(runs, photographs) <= 0.05
    ]
    assert seconds(needs.session_runs, needs.photographs) <= 1.1 * min(enough)


def test_what_the_noise_leaves_cannot_be_bought_with_frames() -> None:
    found = studied_want(want("dprime", 0.05), d_prime(0.01, noise=0.04), SIZE)
    assert found.needs.model_dump(exclude_defaults=True) == {}
    assert "cannot be known to 5 %" in found.sentence
    assert "flats" in found.sentence


def test_without_wants_the_largest_source_of_d_prime_comes_first() -> None:
    text = next_step([], [*sigma(0.01, 0.0), *d_prime(0.06)], SIZE)
    # Half the variance: 11.76 % becomes 8.3 %.
    assert text.startswith("Take 2 more photographs of the scene: d' at zoom 1.5 is then known to")
    assert "8.3 % instead of 12 %" in text


def test_a_quantity_that_the_plan_does_not_determine_says_why() -> None:
    nothing = Prediction(
        quantity="pupil_offset_mm", value=None, variances={}, undetermined="no board"
    )
    found = studied_want(want("pupil", 0.5), [nothing], SIZE)
    assert not found.reached
    assert found.predicted is None
    assert found.sentence == "Nothing can be said of the pupil offset: no board."


def test_a_want_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="above 0"):
        want("tilt", 0.0)
