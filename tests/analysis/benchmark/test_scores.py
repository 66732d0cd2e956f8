"""Scores of hand-made answers, whose values are closed forms."""

from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import standoff
from standoff.library import ScoredBenchmark
from tests.analysis.benchmark.hand_made_set import (
    COLS,
    ROWS,
    HandMadeSet,
    everything,
    ramp,
    write_json,
    write_picture,
    write_table,
)

SHIFT = [[1.0, 0.0, 7.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def value(found: ScoredBenchmark, track: str, measure: str, group: str = "all") -> float:
    score = found.score(found.scores.programs[0].name, track, measure, group)
    assert score is not None, measure
    return score.value


def shifted(px: float) -> dict[str, Any]:
    matrix = [[1.0, 0.0, 7.0 + 0.6 * px], [0.0, 1.0, 0.8 * px], [0.0, 0.0, 1.0]]
    return {"homography_to_reference": matrix}


@pytest.mark.slow
def test_whoever_knows_the_truth_makes_no_error(tmp_path: Path) -> None:
    data, program = everything(tmp_path)
    found = standoff.score_benchmark(program, data)
    for group in ("edges", "photographs"):
        assert value(found, "psf", "answered", group) == 100
        assert value(found, "psf", "mtf50_error_p95", group) == 0
        assert value(found, "psf", "mtf_error_rms", group) == pytest.approx(0, abs=1e-12)
        assert value(found, "psf", "truth_within_95", group) == 100
    # The truth's file has steps of 1/16 DN, which the ramp meets.
    assert value(found, "simulation", "error_median") == 0
    assert value(found, "simulation", "correlation_median") == pytest.approx(1)
    assert value(found, "alignment", "error_median") == 0
    assert value(found, "alignment", "within_0.1_px") == 100
    assert value(found, "alignment", "wrong") == 0
    assert value(found, "alignment", "unrelated_refused") == 100
    for measure in ("spots_found", "pixels_found", "own_precision", "own_recall"):
        assert value(found, "changes", measure) == 100
    assert value(found, "changes", "auc") == 1


def test_sharpness_that_is_wrong_by_a_factor_is_wrong_by_so_many_percent(tmp_path: Path) -> None:
    made = HandMadeSet()
    made.chart("a", {"0": 0.2, "1": 0.3})
    made.chart("b", {"0": 0.25, "1": 0.4})
    program = write_table(
        tmp_path / "mine",
        ["a,0,0.22,0.01,0.92", "a,1,0.27,0.1,0.88", "b,0,0.275,,0.92", "b,1,,,"],
        "chart,edge,mtf50,mtf50_standard_error,mtf_0.1",
    )
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "psf", "answered", "edges") == 75
    assert value(found, "psf", "mtf50_error_median", "edges") == pytest.approx(10)
    assert value(found, "psf", "mtf50_bias", "edges") == pytest.approx(10 / 3)
    assert value(found, "psf", "mtf_error_rms", "edges") == pytest.approx(0.02)
    # 0.02 is two standard errors of 0.01 off, more than 1.96; 0.03 is within 0.196.
    assert value(found, "psf", "truth_within_95", "edges") == 50


@pytest.mark.parametrize("factor", [0.8, 1.1])
def test_a_simulation_of_another_contrast_is_off_by_that_share_of_it(
    factor: float, tmp_path: Path
) -> None:
    made = HandMadeSet()
    made.photograph("t", "scene")
    inside = ramp()[8:-8, 8:-8]
    given = inside.mean() + factor * (ramp() - inside.mean())
    program = write_picture(tmp_path / "mine", "simulation", "t", given)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    # float32 levels of some hundred DN have steps of 6e-5 DN.
    assert value(found, "simulation", "error_median") == pytest.approx(
        100 * abs(factor - 1), rel=1e-5
    )
    assert value(found, "simulation", "correlation_median") == pytest.approx(1)


def test_what_lies_at_the_rim_of_the_reference_or_is_nan_does_not_count(tmp_path: Path) -> None:
    made = HandMadeSet()
    made.photograph("t", "scene")
    given = ramp()
    given[:8] += 1000
    given[:, -8:] -= 1000
    given[8:20, 8:-8] = np.nan
    program = write_picture(tmp_path / "mine", "simulation", "t", given)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "simulation", "error_median") == 0
    assert value(found, "simulation", "pixels_predicted") == pytest.approx(50)
    given[8, 8] = ramp()[8, 8] + 100
    write_picture(program, "simulation", "t", given)
    again = standoff.score_benchmark(program, tmp_path / "data")
    counted = 12 * (COLS - 16) + 1
    wanted = 100 * (100 / sqrt(counted)) / ramp()[8:-8, 8:-8].std()
    assert value(again, "simulation", "error_median") == pytest.approx(wanted, rel=1e-5)


@pytest.mark.parametrize(("px", "within"), [(0.05, 100), (0.3, 0), (1.5, 0)])
def test_a_shift_is_an_error_of_its_length(px: float, within: float, tmp_path: Path) -> None:
    made = HandMadeSet()
    made.pair("a", "scene")
    made.pair("b", "other scene")
    points = [[x + 7.0 + px, float(y)] for y in (0, 20, 39) for x in (0, 30, 59)]
    answers = {"a": shifted(px), "b": {"reference_points": points}}
    program = write_json(tmp_path / "mine", "alignment.json", answers)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "alignment", "error_median") == pytest.approx(px)
    assert value(found, "alignment", "within_0.1_px") == within
    assert value(found, "alignment", "within_2_px") == 100


def test_wrong_are_answers_that_are_far_off_and_those_to_unrelated_pairs(tmp_path: Path) -> None:
    made = HandMadeSet()
    for number in range(4):
        made.pair(f"p{number}", f"scene{number}")
        made.pair(f"u{number}", f"scene{number}", related=False)
    negative = [[-one for one in row] for row in SHIFT]  # the same homography
    answers = {
        "p0": shifted(5.1),
        "p1": shifted(4.9),
        "p2": {"homography_to_reference": negative},
        "p3": {"refused": True},
        "u0": shifted(0.0),
    }
    program = write_json(tmp_path / "mine", "alignment.json", answers)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "alignment", "wrong") == 25
    assert value(found, "alignment", "within_0.1_px") == 25
    assert value(found, "alignment", "refused") == 25
    assert value(found, "alignment", "unrelated_refused") == 75


def test_a_point_beyond_the_horizon_is_nowhere(tmp_path: Path) -> None:
    made = HandMadeSet()
    made.pair("a", "scene")
    horizon = [[1.0, 0.0, 7.0], [0.0, 1.0, 0.0], [-1 / 40, 0.0, 1.0]]
    program = write_json(
        tmp_path / "mine", "alignment.json", {"a": {"homography_to_reference": horizon}}
    )
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "alignment", "wrong") == 100


def change_set(folder: Path, amplitudes_dn: list[float]) -> tuple[HandMadeSet, Path]:
    """Pairs with a spot each in scenes of their own, and one without in each scene."""
    made, program = HandMadeSet(), folder / "mine"
    for number, amplitude_dn in enumerate(amplitudes_dn):
        made.changed(f"c{number:02}", f"scene{number}", [(30, 20, amplitude_dn)])
        made.changed(f"n{number:02}", f"scene{number}", [])
    return made, program


def write_maps(program: Path, amplitudes_dn: list[float], false_score: float) -> None:
    """An observer who sees amplitudes, and in each unchanged frame two places of this score."""
    for number, amplitude_dn in enumerate(amplitudes_dn):
        scores = np.zeros((ROWS, COLS))
        scores[20, 31] = amplitude_dn  # within 2 px of the spot
        write_picture(program, "changes", f"c{number:02}", scores)
        scores = np.zeros((ROWS, COLS))
        scores[5, 5] = scores[30, 50] = false_score
        write_picture(program, "changes", f"n{number:02}", scores)


def test_the_limit_of_an_observer_who_sees_amplitudes_is_where_its_false_places_begin(
    tmp_path: Path,
) -> None:
    amplitudes = [float(16 * 2 ** (step / 2)) for step in (-5, -3, -1, 1, 3, 5)]
    made, program = change_set(tmp_path, amplitudes)
    write_maps(program, amplitudes, false_score=16.0)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    # Amplitudes are stored in 1/16 DN: the middle in the logarithm is 16 DN to a fraction of that.
    assert value(found, "changes", "limit_50_dn") == pytest.approx(16, rel=0.01)
    noise_dn = sqrt(4 + 0.5 * 1000)
    assert value(found, "changes", "limit_50_noises") == pytest.approx(16 / noise_dn, rel=0.01)
    assert value(found, "changes", "spots_found") == 50
    assert value(found, "changes", "false_places") == 0
    # Of a changed map's largest scores those above 16 DN win against all of the unchanged.
    assert value(found, "changes", "auc") == 0.5


def test_who_finds_nothing_has_a_limit_above_the_largest_amplitude(tmp_path: Path) -> None:
    made, program = change_set(tmp_path, [10.0, 20.0, 40.0])
    write_maps(program, [1.0, 1.0, 1.0], false_score=5.0)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    score = found.score("mine", "changes", "limit_50_dn")
    assert score is not None
    assert (score.relation, score.value, score.high) == (">", 40.0, None)


def test_a_map_that_declares_every_pixel_changed_finds_nothing(tmp_path: Path) -> None:
    made, program = change_set(tmp_path, [10.0, 20.0, 40.0])
    for name in made.changes:
        write_picture(program, "changes", name, np.ones((ROWS, COLS)))
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "changes", "spots_found") == 0
    assert value(found, "changes", "auc") == 0.5


def test_a_region_is_false_if_it_lies_away_from_every_spot(tmp_path: Path) -> None:
    made, program = change_set(tmp_path, [10.0, 20.0])
    write_maps(program, [10.0, 20.0], false_score=5.0)
    scores = np.zeros((ROWS, COLS))
    scores[20, 30:50] = 9.0  # begins at the spot
    scores[20 + 8, 30] = 9.0  # 8 px away, more than 3 sigma + 4 px
    scores[20 - 7, 30] = 9.0  # 7 px away, not more
    write_picture(program, "changes", "c00", scores)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "changes", "false_places") == 0.5  # one in two changed frames


def test_own_detections_are_counted_at_the_programs_threshold(tmp_path: Path) -> None:
    made, program = change_set(tmp_path, [10.0, 20.0, 30.0, 40.0])
    places = {
        "c00": [[31.9, 20.0], [30.0, 20.0]],  # two of one spot
        "c01": [[33.0, 20.0]],  # neither at the spot nor away from it
        "c02": [[10.0, 10.0], [30.0, 21.0]],
        "n00": [[1.0, 1.0]],
    }
    write_json(program, "detections.json", places)
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "changes", "own_recall") == 50
    assert value(found, "changes", "own_precision") == 50
    assert value(found, "changes", "own_false_places") == 2 / 8


def test_what_the_reference_does_not_show_counts_for_nothing(tmp_path: Path) -> None:
    """Nor do pixels within 2 px of it; those beyond do."""
    made, program = change_set(tmp_path, [10.0, 20.0])
    unseen = np.zeros((ROWS, COLS), np.uint8)
    unseen[30:34, 5:9] = 1
    for name in made.changes:
        made.changes[name]["unseen"] = f"truth/changes/{name}-unseen.tif"
        made.pictures[f"truth/changes/{name}-unseen.tif"] = unseen
    write_maps(program, [10.0, 20.0], false_score=5.0)
    scores = np.zeros((ROWS, COLS))
    scores[20, 30] = 9.0
    scores[28:36, 3:11] = 99.0
    write_picture(program, "changes", "c00", scores)
    scores[20, 30] = 0.0
    write_picture(program, "changes", "n00", scores)
    write_json(program, "detections.json", {"n00": [[3.0, 28.0], [2.0, 28.0]], "c00": [[6, 31]]})
    found = standoff.score_benchmark(program, made.write(tmp_path / "data"))
    assert value(found, "changes", "spots_found") == 100
    assert value(found, "changes", "false_places") == 0
    assert value(found, "changes", "own_false_places") == 1 / 4


@pytest.mark.slow
@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    power=st.sampled_from([0.5, 1.0, 3.0]),
    factor=st.floats(0.01, 100),
    offset=st.floats(-5, 5),
    seed=st.integers(0, 99),
)
def test_any_rising_function_of_a_map_has_its_scores(
    power: float, factor: float, offset: float, seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    made = HandMadeSet()
    for number in range(3):
        made.changed(f"c{number}", f"scene{number}", [(10, 10, 20.0), (40, 25, 50.0)])
        made.changed(f"n{number}", f"scene{number}", [])
    data = made.write(tmp_path / "data")
    for name in made.changes:
        # Of whole numbers, so that no two levels become one in float32.
        levels = rng.integers(0, 50, (ROWS, COLS)).astype(np.float64)
        write_picture(tmp_path / "plain" / "mine", "changes", name, levels)
        rising = factor * levels**power + offset
        write_picture(tmp_path / "other" / "mine", "changes", name, rising)
    plain, other = (
        standoff.score_benchmark(tmp_path / folder / "mine", data) for folder in ("plain", "other")
    )
    assert plain.scores.scores == other.scores.scores


@pytest.mark.slow
@settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(order=st.permutations(["p0", "p1", "p2", "u0", "u1"]), refused=st.integers(0, 5))
def test_the_order_of_tasks_is_nothing_and_refusing_more_is_never_more_wrong(
    order: list[str], refused: int, tmp_path: Path
) -> None:
    answers = {
        name: shifted(px)
        for name, px in zip(["p0", "p1", "p2", "u0"], [0.0, 9.0, 1.0, 0.0], strict=True)
    }
    wrong = []
    for number, names in enumerate((sorted(order), order, order[refused:])):
        made = HandMadeSet()
        for name in order if number else sorted(order):
            made.pair(name, f"scene{name[1]}", related=name[0] == "p")
        program = write_json(
            tmp_path / str(number) / "mine",
            "alignment.json",
            {name: answers[name] for name in names if name in answers},
        )
        found = standoff.score_benchmark(program, made.write(tmp_path / str(number) / "data"))
        wrong.append((value(found, "alignment", "wrong"), found.scores.scores))
    assert wrong[0] == wrong[1]
    assert wrong[2][0] <= wrong[1][0]


@pytest.mark.slow
def test_programs_side_by_side_have_the_scores_that_each_has_alone(tmp_path: Path) -> None:
    data, program = everything(tmp_path)
    other = write_json(tmp_path / "other", "alignment.json", {"p0": shifted(1.0)})
    both = standoff.score_benchmark([program, other], data)
    assert both.scores.scores == [
        *standoff.score_benchmark(program, data).scores.scores,
        *standoff.score_benchmark(other, data).scores.scores,
    ]
    text = standoff.score_benchmark([other, program], data).to_dataframe()
    assert sorted(set(text["program"])) == ["knows", "other"]
