from collections.abc import Sequence
from math import radians
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.edges import EdgeImage, EdgeMeasurement, edges_of_image
from calibration.errors import LimitsFileError
from calibration.estimate import Estimate
from calibration.sharpness import (
    LimitVerdict,
    Picture,
    SharpnessLimits,
    edge_row,
    judge_sharpness,
    position_in_field,
    read_limits,
    reported_mtf50,
    verdict_rows,
)
from calibration.sharpness._verdict import (
    _Figure,
    _largest,
    _median_of,
    _outcome_of,
    _smallest,
    ratio,
)
from standoff.shipped_configs import shipped_config
from tests.calibration.closed_form import edge_image
from tests.calibration.diffraction import diffracted_edge, system_mtf50
from tests.calibration.sharpness.edges import edge_of


@pytest.mark.parametrize(
    ("place", "corner"),
    [
        ((0.0, 0.0), "top left"),
        ((100.0, 0.0), "top right"),
        ((0.0, 80.0), "bottom left"),
        ((100.0, 80.0), "bottom right"),
    ],
)
def test_a_corner_is_one_half_diagonal_from_the_centre(
    place: tuple[float, float], corner: str
) -> None:
    found = position_in_field(edge_of(x_px=place[0], y_px=place[1]), 101, 81)
    assert found.radius == pytest.approx(1.0)
    assert found.corner == corner


@pytest.mark.parametrize(
    ("place", "angle_deg", "direction"),
    [
        # To the right of the centre a vertical edge has its normal along the radius.
        ((90.0, 40.0), 90.0, "meridional"),
        ((90.0, 40.0), 0.0, "sagittal"),
        ((50.0, 5.0), 0.0, "meridional"),
        ((50.0, 5.0), 90.0, "sagittal"),
        # Right and below, y down: the radius runs at 45 degrees, an edge across it at 135.
        ((80.0, 70.0), 135.0, "meridional"),
        ((80.0, 70.0), 45.0, "sagittal"),
        ((20.0, 70.0), 45.0, "meridional"),
        ((50.0, 40.0), 90.0, None),
    ],
)
def test_an_edge_across_the_radius_is_meridional_and_one_along_it_sagittal(
    place: tuple[float, float], angle_deg: float, direction: str | None
) -> None:
    found = position_in_field(edge_of(angle_deg, x_px=place[0], y_px=place[1]), 101, 81)
    assert found.direction == direction


VALUES = st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.0, 0.2)), min_size=1, max_size=12)


def figures(pairs: list[tuple[float, float]]) -> list[_Figure]:
    return [_Figure(value=value, err=err, where=f"{k}") for k, (value, err) in enumerate(pairs)]


@given(pairs=VALUES)
def test_the_smallest_is_within_its_interval_and_below_the_largest(
    pairs: list[tuple[float, float]],
) -> None:
    low, high = _smallest(figures(pairs)), _largest(figures(pairs))
    assert low.low <= low.value == min(value for value, _ in pairs)
    assert high.value == max(value for value, _ in pairs) <= high.high
    assert low.low <= low.high
    assert high.low <= high.high


@given(pairs=VALUES)
def test_one_more_edge_never_raises_the_lower_end_of_the_smallest(
    pairs: list[tuple[float, float]],
) -> None:
    fewer = pairs[:-1] or pairs
    assert _smallest(figures(pairs)).low <= _smallest(figures(fewer)).low


def test_a_single_figure_is_its_own_smallest_and_largest() -> None:
    one = _Figure(value=0.3, err=0.01, where="here")
    # The 97.5 % point of a unit normal.
    assert one.low == pytest.approx(0.3 - 0.0195996, abs=1e-7)
    for found in (_smallest([one]), _largest([one])):
        assert (found.low, found.high, found.where) == pytest.approx((one.low, one.high, "here"))


@pytest.mark.parametrize("count", [1, 8, 60])
def test_the_interval_of_the_smallest_holds_the_true_one_in_95_percent(count: int) -> None:
    rng = np.random.default_rng(count)
    held = 0
    for _ in range(600):
        truth = rng.uniform(0.2, 0.3, count)
        errs = rng.uniform(0.005, 0.03, count)
        seen = rng.normal(truth, errs)
        found = _smallest([_Figure(value=v, err=e) for v, e in zip(seen, errs, strict=True)])
        held += found.low <= truth.min() <= found.high
    # Binomial: 600 trials at 95 % give 543 or more in 999 of 1000.
    assert held >= 543


def test_the_median_of_few_has_their_own_errors_and_of_many_their_scatter() -> None:
    two = _median_of([_Figure(value=0.2, err=0.03), _Figure(value=0.4, err=0.04)], "zone")
    # A mean of two: sqrt(0.03^2 + 0.04^2) / 2.
    assert (two.value, two.err) == pytest.approx((0.3, 0.025))
    assert two.where == "zone (2 edges)"
    values = [0.1, 0.2, 0.3, 0.4, 0.5]
    scattered = _median_of([_Figure(value=v, err=1e-6) for v in values], "zone")
    # Median absolute deviation 0.1: 1.2533 * 0.1 / 0.67449 / sqrt(5).
    assert scattered.err == pytest.approx(0.083098, rel=1e-4)


def test_a_shift_without_its_sign_includes_0_where_its_interval_does() -> None:
    crossing = _Figure(value=-0.1, err=0.1).modulus()
    assert (crossing.value, crossing.low) == (0.1, 0.0)
    assert crossing.high == pytest.approx(0.1 + 0.195996, abs=1e-6)
    clear = _Figure(value=-0.5, err=0.1).modulus()
    assert (clear.low, clear.high) == pytest.approx((0.304004, 0.695996), abs=1e-6)


def test_a_ratio_covers_its_truth() -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(600):
        above, below = rng.normal([0.15, 0.25], [0.01, 0.012])
        found = ratio(_Figure(value=above, err=0.01), _Figure(value=below, err=0.012))
        held += found.low <= 0.6 <= found.high
    assert held >= 543


@pytest.mark.parametrize("function", [_smallest, _largest])
def test_of_nothing_there_is_no_extreme(function: object) -> None:
    with pytest.raises(ValueError, match="no figures"):
        function([])  # type: ignore[operator]


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    return path


def test_limits_are_read_in_the_order_of_the_tables(tmp_path: Path) -> None:
    limits = read_limits(
        written(tmp_path, "[sigma]\nmax_px = 0.9\n[mtf50]\ncorner_min_lw_per_ph = 800\n")
    )
    assert list(limits.given()) == [("mtf50.corner_min_lw_per_ph", 800.0), ("sigma.max_px", 0.9)]
    assert limits.zones.centre_radius == 0.3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[mtf50]\nmin_cypx = 0.2\n", "unknown key mtf50.min_cypx"),
        ("[mtf50]\nmin_cy_per_pixel = 1\n", "did you mean mtf50.min_cy_per_px?"),
        ("[sigmas]\nmax_px = 1\n", "unknown key sigmas"),
        ("[mtf50]\nmin_cy_per_px = 0\n", "mtf50.min_cy_per_px"),
        ("[mtf50]\nmin_cy_per_px = nan\n", "mtf50.min_cy_per_px"),
        ('[mtf50]\nmin_cy_per_px = "0,2"\n', "0.2"),
        ("[mtf50]\nmin_cy_per_px = 0,2\n", "line 2"),
        ("[uniformity]\ncorner_to_centre_min = 70\n", "uniformity.corner_to_centre_min"),
        ("[zones]\ncentre_radius = 0.8\ncorner_radius = 0.7\n", "must not exceed corner_radius"),
        ("[zones]\ncentre_radius = 0.2\n", "it sets no limit; set one"),
        ("", "it sets no limit; set one"),
        ("[mtf50", "not valid TOML"),
    ],
)
def test_a_file_at_fault_is_refused_by_the_name_of_the_key(
    tmp_path: Path, text: str, message: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(LimitsFileError) as refused:
        read_limits(path)
    assert str(path) in str(refused.value)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LimitsFileError, match=r"none\.toml: No such file"):
        read_limits(tmp_path / "none.toml")


def test_the_shipped_example_is_read() -> None:
    keys = [key for key, _ in read_limits(shipped_config("limits.toml")).given()]
    assert "mtf50.centre_min_cy_per_px" in keys
    assert "lateral_colour.max_px" in keys


PICTURE = Picture(width_px=801, height_px=601, pixel_pitch_um=5.0)
CORNERS = ((20.0, 20.0), (780.0, 20.0), (20.0, 580.0), (780.0, 580.0))
LADDER = {"pass": 0, "unsure": 1, "fail": 2}


def sharp(mtf50: float, err: float = 0.0, **changes: object) -> EdgeMeasurement:
    return edge_of(**{"esfr_mtf50_cy_per_px": mtf50, "esfr_mtf50_err_cy_per_px": err, **changes})


def verdict_on(
    edges: Sequence[EdgeMeasurement], picture: Picture = PICTURE, **tables: object
) -> LimitVerdict:
    limits = SharpnessLimits.model_validate(tables)
    [one] = judge_sharpness(limits, edges, picture, "limits.toml").limits
    return one


@pytest.mark.parametrize(("value", "outcome"), [(0.02, "pass"), (0.049, "unsure"), (0.09, "fail")])
def test_figures_of_the_camera_are_compared_like_those_of_edges(value: float, outcome: str) -> None:
    limits = SharpnessLimits.model_validate({"sharpening": {"max_overshoot": 0.05}})
    measured = {"sharpening.max_overshoot": Estimate(value=value, err=0.005)}
    [one] = judge_sharpness(limits, [sharp(0.3)], PICTURE, "limits.toml", measured).limits
    assert (one.outcome, one.value, one.where) == (outcome, value, "camera")


def test_a_figure_of_the_camera_that_was_not_measured_leaves_it_unsure() -> None:
    one = verdict_on([sharp(0.3)], camera={"min_dynamic_range_db": 60})
    assert (one.outcome, one.unit, one.is_least) == ("unsure", "dB", True)
    assert "standoff lens" in str(one.reason)


ENDS = st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted)


@given(ends=ENDS, bound=st.floats(0, 1))
def test_it_is_unsure_exactly_where_the_interval_straddles_the_limit(
    ends: list[float], bound: float
) -> None:
    low, high = ends
    least = _outcome_of(low, high, bound, at_least=True)
    assert (least == "unsure") is (low < bound <= high)
    most = _outcome_of(low, high, bound, at_least=False)
    assert (most == "unsure") is (low <= bound < high)


@given(ends=ENDS, first=st.floats(0, 1), second=st.floats(0, 1))
def test_a_stricter_limit_is_never_easier_to_keep(
    ends: list[float], first: float, second: float
) -> None:
    lower, upper = sorted((first, second))
    low, high = ends

    def rung(bound: float, *, at_least: bool) -> int:
        return LADDER[_outcome_of(low, high, bound, at_least=at_least)]

    assert rung(lower, at_least=True) <= rung(upper, at_least=True)
    assert rung(upper, at_least=False) <= rung(lower, at_least=False)


@given(
    values=st.lists(st.floats(0.05, 0.6), min_size=1, max_size=8),
    err=st.floats(0, 0.05),
    first=st.floats(0.01, 0.7),
    second=st.floats(0.01, 0.7),
)
def test_a_verdict_is_monotone_in_its_limit(
    values: list[float], err: float, first: float, second: float
) -> None:
    edges = [sharp(value, err) for value in values]
    loose, strict = sorted((first, second))
    ranks = [
        LADDER[verdict_on(edges, mtf50={"min_cy_per_px": bound}).outcome]
        for bound in (loose, strict)
    ]
    assert ranks[0] <= ranks[1]


@given(
    values=st.lists(st.floats(0.05, 0.6), min_size=1, max_size=8),
    err=st.floats(0, 0.05),
    bound=st.floats(0.01, 0.7),
)
def test_the_outcome_follows_from_the_interval_in_the_document(
    values: list[float], err: float, bound: float
) -> None:
    one = verdict_on([sharp(value, err) for value in values], mtf50={"min_cy_per_px": bound})
    assert one.low is not None
    assert one.high is not None
    assert one.value == min(values)
    assert one.outcome == _outcome_of(one.low, one.high, bound, at_least=True)


def test_figures_come_in_the_unit_of_their_limit() -> None:
    edges = [sharp(0.25)]
    assert verdict_on(edges, mtf50={"min_lw_per_ph": 300}).value == pytest.approx(2 * 0.25 * 601)
    assert verdict_on(edges, mtf50={"min_lp_per_mm": 50}).value == pytest.approx(50.0)
    assert verdict_on(edges, mtf50={"min_lp_per_mm": 50}).unit == "lp/mm"


def test_the_centre_is_judged_by_its_median_and_the_corners_by_the_worst_of_them() -> None:
    edges = [sharp(value, x_px=400.0 + k, y_px=290.0) for k, value in enumerate((0.2, 0.3, 0.4))]
    for k, (x, y) in enumerate(CORNERS):
        edges.append(sharp(0.15 + 0.01 * k, x_px=x, y_px=y))
    centre = verdict_on(edges, mtf50={"centre_min_cy_per_px": 0.25})
    assert (centre.value, centre.where) == (0.3, "centre (3 edges)")
    corner = verdict_on(edges, mtf50={"corner_min_cy_per_px": 0.16})
    assert (corner.value, corner.outcome) == (0.15, "fail")
    assert corner.where.startswith("top left, ")
    ratio = verdict_on(edges, uniformity={"corner_to_centre_min": 0.4})
    assert ratio.value == pytest.approx(0.5)
    tilt = verdict_on(edges, uniformity={"corner_to_corner_min": 0.9})
    assert tilt.value == pytest.approx(0.15 / 0.18)
    assert tilt.outcome == "fail"


def test_a_soft_direction_of_a_corner_is_not_averaged_with_a_sharp_one() -> None:
    edges = [sharp(0.3, x_px=x, y_px=y) for x, y in CORNERS]
    edges += [sharp(0.1, x_px=780.0, y_px=20.0, angle_deg=float(a)) for a in (45.0, 135.0)]
    # 45 and 135 degrees are across and along the radius there: one of them shares no group
    # with the others.
    one = verdict_on(edges, mtf50={"corner_min_cy_per_px": 0.2})
    assert (one.value, one.outcome) == (0.1, "fail")


def test_widths_are_judged_by_the_widest_edge_and_rejected_edges_do_not_count() -> None:
    edges = [
        edge_of(sigma_px=0.8, sigma_err_px=0.0),
        edge_of(sigma_px=0.9, sigma_err_px=0.0),
        edge_of(sigma_px=2.0, flags=["saturated"]),
    ]
    assert verdict_on(edges, sigma={"max_px": 0.9}).outcome == "pass"
    assert verdict_on(edges, sigma={"max_px": 0.89}).outcome == "fail"
    assert verdict_on(edges, sigma={"optical_max_px": 0.7}).value == 0.64


def test_lateral_colour_is_judged_by_the_largest_shift_of_either_sign() -> None:
    shifted = edge_of(
        red_shift_px=0.1, red_shift_err_px=0.0, blue_shift_px=-0.4, blue_shift_err_px=0.001
    )
    one = verdict_on([edge_of(), shifted], lateral_colour={"max_px": 0.3})
    assert (one.value, one.outcome) == (0.4, "fail")
    assert one.where == "blue, edge at (55, 45)"


@pytest.mark.parametrize(
    ("tables", "picture", "reason"),
    [
        ({"mtf50": {"min_lp_per_mm": 9}}, {"pixel_pitch_um": None}, "give --pixel-pitch-um"),
        ({"mtf50": {"min_lw_per_ph": 9}}, {"height_px": None}, "differ in size"),
        ({"mtf50": {"centre_min_cy_per_px": 0.1}}, {}, "no edge within 0.3 half diagonals"),
        (
            {"mtf50": {"corner_min_cy_per_px": 0.1}},
            {},
            "from the centre, bottom left, bottom right, top right; ",
        ),
        ({"lateral_colour": {"max_px": 1}}, {}, "have no colours"),
    ],
)
def test_what_was_not_measured_is_unsure_with_the_remedy(
    tables: dict[str, object], picture: dict[str, object], reason: str
) -> None:
    size = {"width_px": 801, "height_px": 601, "pixel_pitch_um": 5.0, **picture}
    edges = [sharp(0.3, x_px=20.0, y_px=20.0)]
    one = verdict_on(edges, Picture(**size), **tables)  # type: ignore[arg-type]
    assert (one.outcome, one.value) == ("unsure", None)
    assert one.reason is not None
    assert reason in one.reason


@pytest.mark.parametrize(
    ("bounds", "outcome"),
    [((0.1, 0.1), "pass"), ((0.3, 0.1), "unsure"), ((0.1, 0.9), "fail"), ((0.3, 0.9), "fail")],
)
def test_one_failed_limit_fails_all_and_one_unsure_leaves_it_unsure(
    bounds: tuple[float, float], outcome: str
) -> None:
    # 0.3 +- 0.02 straddles 0.3; pixels of 5 um make it 60 lp/mm.
    limits = SharpnessLimits.model_validate(
        {"mtf50": {"min_cy_per_px": bounds[0], "min_lp_per_mm": 100 * bounds[1]}}
    )
    found = judge_sharpness(limits, [sharp(0.3, 0.01)], PICTURE, "l.toml")
    assert found.outcome == outcome
    assert len(found.limits) == 2


def test_a_reason_that_several_limits_share_is_written_out_once() -> None:
    limits = SharpnessLimits.model_validate(
        {
            "mtf50": {"min_cy_per_px": 0.1, "corner_min_cy_per_px": 0.1},
            "uniformity": {"corner_to_centre_min": 0.5, "corner_to_corner_min": 0.5},
        }
    )
    verdict = judge_sharpness(limits, [sharp(0.3, x_px=400.0, y_px=300.0)], PICTURE, "l.toml")
    every, corner, *uniform = verdict_rows(verdict)
    assert every[2] == "0.3000"
    assert "in any corner" in corner[-1]
    assert [row[-1] for row in uniform] == ["as for mtf50.corner_min_cy_per_px"] * 2


CUTOFF, NORMAL_DEG = 2.5, 4.0


def test_mtf50_of_a_table_is_the_measured_one_and_the_gaussians_is_named_so() -> None:
    [edge] = edges_of_image(EdgeImage(name="e", image_dn=diffracted_edge(CUTOFF, NORMAL_DEG)))
    row = edge_row(edge)
    truth = system_mtf50(CUTOFF, radians(NORMAL_DEG))
    assert row["mtf50_cy_per_px"] == pytest.approx(truth, rel=1e-3)
    assert row["mtf50_err_cy_per_px"] == reported_mtf50(edge).err_cy_per_px
    assert row["mtf50_from"] == "e-SFR"
    # A Gaussian has no tails: it is some 2 % low, and stands under its own name alone.
    assert row["gaussian_mtf50_cy_per_px"] == edge.mtf50_cy_per_px
    assert row["gaussian_mtf50_cy_per_px"] < 0.99 * truth


def test_of_a_gaussian_lens_both_are_the_same() -> None:
    [edge] = edges_of_image(EdgeImage(name="e", image_dn=edge_image(0.8, 5.0)))
    row = edge_row(edge)
    assert row["mtf50_cy_per_px"] == pytest.approx(row["gaussian_mtf50_cy_per_px"], rel=1e-3)


def test_every_unit_is_of_the_same_mtf50() -> None:
    measured = {"cy_per_px": 0.25, "err_cy_per_px": 0.01, "lw_per_ph": 200.0, "lp_per_mm": 50.0}
    gaussian = {"cy_per_px": 0.2, "err_cy_per_px": 0.02, "lw_per_ph": 160.0, "lp_per_mm": 40.0}
    edge = edge_of(
        **{f"mtf50_{unit}": value for unit, value in gaussian.items()},
        **{f"esfr_mtf50_{unit}": value for unit, value in measured.items()},
    )
    row = edge_row(edge)
    assert {unit: row[f"mtf50_{unit}"] for unit in measured} == measured
    assert {unit: row[f"gaussian_mtf50_{unit}"] for unit in gaussian} == gaussian
    without = edge_row(edge.model_copy(update={"esfr_mtf50_err_cy_per_px": None}))
    assert {unit: without[f"mtf50_{unit}"] for unit in gaussian} == gaussian
    assert without["mtf50_from"] == "gaussian"
    assert without["esfr_mtf50_cy_per_px"] == 0.25
