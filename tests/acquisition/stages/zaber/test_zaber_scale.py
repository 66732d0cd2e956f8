from typing import Any

import pytest

from acquisition.bench import StageConfig
from acquisition.errors import BenchConfigError
from acquisition.stages.zaber import ZaberScale


def scale(**keys: Any) -> ZaberScale:
    return ZaberScale.of(
        StageConfig.model_validate(
            {
                "driver": "zaber",
                "port": "virtual",
                "microstep_um": 0.5,
                "limits_mm": [10.0, 100.0],
                **keys,
            }
        )
    )


@pytest.mark.parametrize(("direction", "sign"), [("up", 1), ("down", -1)])
def test_a_height_is_its_microsteps_and_back(direction: str, sign: int) -> None:
    found = scale(direction=direction, home_offset_mm=50.0)
    # By hand: 7 mm are 14 000 half micrometres.
    assert found.steps(57.0) == sign * 14_000
    assert found.height_mm(sign * 14_000) == 57.0


@pytest.mark.parametrize("direction", ["up", "down"])
def test_rounding_never_leaves_the_limits(direction: str) -> None:
    # Microsteps of 0.3 mm from 0: 10 lies between 9.9 and 10.2, 100 between 99.9 and 100.2.
    found = scale(direction=direction, microstep_um=300.0)
    assert found.height_mm(found.steps(10.0)) == pytest.approx(10.2)
    assert found.height_mm(found.steps(100.0)) == pytest.approx(99.9)
    # 10.5 lies amid 10.5 itself; 99.8 nearest to 99.9, which is inside.
    assert found.height_mm(found.steps(99.8)) == pytest.approx(99.9)


def test_a_feed_is_the_protocols_unit_of_speed() -> None:
    # 60 mm/min are 2000 microsteps a second, times 1.6384.
    assert scale().maxspeed(60.0) == round(2000 * 1.6384)


def test_a_stage_without_its_microstep_has_no_scale() -> None:
    manual = StageConfig.model_validate({"driver": "manual", "limits_mm": [10.0, 100.0]})
    with pytest.raises(BenchConfigError) as missing:
        ZaberScale.of(manual)
    assert missing.value.keys == ("stage.microstep_um",)
