"""How a value and half its 95 % interval are written side by side."""

import pytest
from hypothesis import given, strategies as st

from calibration.estimate import signed_with_reach


@pytest.mark.parametrize(
    ("value", "reach_95", "text"),
    [
        (7.378725, 9.4139, "+7.4 ± 9.4"),
        (106.04, 23.4, "+106 ± 23"),
        (1234.5, 123.4, "+1234 ± 123"),
        (-0.0213, 0.0017, "-0.0213 ± 0.0017"),
        (6.28e-17, 0.57, "+0.00 ± 0.57"),
        (-0.0004, 0.0996, "+0.00 ± 0.10"),
        (12.3456, 0.0, "+12.3 ± 0"),
        (12.3456, float("inf"), "+12.3 ± inf"),
        (3.21e-9, 1.23e-9, "+3.21e-09 ± 1.2e-09"),
    ],
)
def test_value_and_half_interval_end_at_one_digit(value: float, reach_95: float, text: str) -> None:
    assert signed_with_reach(value, reach_95) == text


@given(
    value=st.floats(-1e6, 1e6),
    reach_95=st.floats(1e-5, 1e6),
)
def test_what_is_written_is_what_was_measured(value: float, reach_95: float) -> None:
    written, reach = signed_with_reach(value, reach_95).split(" ± ")
    assert written[0] in "+-"
    assert len(written.partition(".")[2]) == len(reach.partition(".")[2])
    # Half a unit of the second of two digits is a twentieth at most.
    assert float(reach) == pytest.approx(reach_95, rel=0.05)
    assert float(written) == pytest.approx(value, abs=0.05 * reach_95 + 1e-9)
    assert float(written) != 0 or written[0] == "+"
