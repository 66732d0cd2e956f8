"""The height that a display shows while another thread moves the stage."""

import pytest

from acquisition.devices import TravellingStage
from tests.hil_mocks.stage_rigs import grbl_rig, homed_grbl, zaber_rig


def test_a_grbl_stage_tells_its_height_on_the_way_without_sending_anything() -> None:
    rig = homed_grbl("grblhal")
    seen: list[tuple[float | None, float]] = []
    rig.in_mid_move(
        lambda: seen.append((rig.stage.travel_height_mm(), rig.plant.true_height_mm)), 3.0
    )
    before_mm = rig.stage.position_mm()
    rig.stage.move_to(300.0, 120)
    ((told_mm, true_mm),) = seen
    assert told_mm is not None
    assert before_mm < told_mm < 300.0
    # The last report is at most 50 ms old, at 20 mm/s; a line takes some milliseconds.
    assert told_mm == pytest.approx(true_mm, abs=20 * 0.08)


def test_a_stage_that_does_not_know_its_height_tells_none() -> None:
    assert grbl_rig("grblhal").stage.travel_height_mm() is None
    assert zaber_rig().stage.travel_height_mm() is None


def test_a_zaber_stage_tells_the_height_it_is_asked_for() -> None:
    rig = zaber_rig()
    rig.stage.home(120)
    height_mm = rig.stage.move_to(150.0, 120)
    assert isinstance(rig.stage, TravellingStage)
    assert rig.stage.travel_height_mm() == height_mm
