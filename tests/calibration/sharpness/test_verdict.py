from collections.abc import Sequence

import pytest
from hypothesis import given, strategies as st

from calibration.edges import EdgeMeasurement
from calibration.sharpness import (
    LimitVerdict,
    Picture,
    SharpnessLimits,
    judge_sharpness,
    verdict_rows,
)
from calibration.sharpness.verdict import outcome_of
from tests.calibration.sharpness.edges import edge_of

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


ENDS = st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted)


@given(ends=ENDS, bound=st.floats(0, 1))
def test_it_is_unsure_exactly_where_the_interval_straddles_the_limit(
    ends: list[float], bound: float
) -> None:
    low, high = ends
    least = outcome_of(low, high, bound, at_least=True)
    assert (least == "unsure") is (low < bound <= high)
    most = outcome_of(low, high, bound, at_least=False)
    assert (most == "unsure") is (low <= bound < high)


@given(ends=ENDS, first=st.floats(0, 1), second=st.floats(0, 1))
def test_a_stricter_limit_is_never_easier_to_keep(
    ends: list[float], first: float, second: float
) -> None:
    lower, upper = sorted((first, second))
    low, high = ends

    def rung(bound: float, *, at_least: bool) -> int:
        return LADDER[outcome_of(low, high, bound, at_least=at_least)]

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
    assert one.outcome == outcome_of(one.low, one.high, bound, at_least=True)


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
