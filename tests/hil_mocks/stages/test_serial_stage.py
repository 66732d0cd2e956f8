"""The real drivers over a real (pseudo-)terminal, with threads and cables."""

import time
from collections.abc import Iterator
from threading import Thread

import pytest

from acquisition.bench import StageConfig
from acquisition.errors import DeviceDisconnectedError, DeviceError
from acquisition.stages import open_zaber_stage
from acquisition.stages._grbl import open_grbl_stage
from acquisition.stages._motor import MotorStage
from hil_mocks.stages._serial_stage import LineFaults, SerialStage, StageProtocol
from tests.busy_machine import BUSY_S

pytestmark = pytest.mark.slow

JOIN_S = 30.0


def opened(served: SerialStage, protocol: StageProtocol) -> MotorStage:
    config = StageConfig.model_validate(
        {
            "driver": protocol,
            "port": served.port,
            "limits_mm": [120.0, 500.0],
            "home_offset_mm": 519.5 if protocol == "grbl" else 119.5,
            "microstep_um": 0.49609375,
            "feed_mm_per_min": 1200.0,
            "settle_s": 0.05,
        }
    )
    return open_grbl_stage(config) if protocol == "grbl" else open_zaber_stage(config)


@pytest.fixture(params=["grbl", "zaber"])
def protocol(request: pytest.FixtureRequest) -> StageProtocol:
    chosen: StageProtocol = request.param
    return chosen


@pytest.fixture
def served(protocol: StageProtocol) -> Iterator[SerialStage]:
    with SerialStage(protocol) as stage:
        stage.plant.place(125.0)
        yield stage


class Failing(Thread):
    """Runs a call of the driver and keeps its error."""

    error: DeviceError | None = None

    def run(self) -> None:
        try:
            super().run()
        except DeviceError as error:
            self.error = error


def wait_until_moving(served: SerialStage, from_mm: float) -> None:
    deadline = time.monotonic() + JOIN_S
    while abs(served.true_height_mm - from_mm) < 1.0:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_stop_from_another_thread_ends_homing_at_once(
    served: SerialStage, protocol: StageProtocol
) -> None:
    served.plant.place(300.0)
    stage = opened(served, protocol)
    homing = Failing(target=stage.home, args=(60.0,))
    homing.start()
    wait_until_moving(served, 300.0)
    before_mm = served.true_height_mm
    stage.stop()
    homing.join(JOIN_S)
    assert isinstance(homing.error, DeviceError)
    assert not stage.is_homed
    # Ramp, and what the loaded machine of a test takes to pass the stop on.
    assert before_mm - served.true_height_mm < 20.0
    stage.close()


def test_a_stop_from_another_thread_ends_a_move(
    served: SerialStage, protocol: StageProtocol
) -> None:
    stage = opened(served, protocol)
    stage.home(60.0)
    start_mm = served.true_height_mm
    moving = Failing(target=stage.move_to, args=(400.0, 60.0))
    moving.start()
    wait_until_moving(served, start_mm)
    stage.stop()
    moving.join(JOIN_S)
    assert "told to" in str(moving.error)
    assert stage.is_homed
    assert stage.position_mm() == pytest.approx(served.true_height_mm, abs=0.05)
    stage.close()


def test_a_pulled_cable_is_known_in_half_a_second_and_the_stage_runs_on(
    served: SerialStage, protocol: StageProtocol
) -> None:
    stage = opened(served, protocol)
    stage.home(60.0)
    start_mm = served.true_height_mm
    moving = Failing(target=stage.move_to, args=(150.0, 60.0))
    moving.start()
    wait_until_moving(served, start_mm)
    pulled_s = time.monotonic()
    served.line.faults = LineFaults(unplugged=True)
    moving.join(JOIN_S)
    assert isinstance(moving.error, DeviceDisconnectedError)
    assert time.monotonic() - pulled_s < 0.5 + BUSY_S
    deadline = time.monotonic() + JOIN_S
    while abs(served.true_height_mm - 150.0) > 0.05:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    stage.close()
