"""What the driver makes of a network and a camera that misbehave."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from acquisition.aravis._camera import AravisCamera, _AravisConnection
from acquisition.aravis._configuration import NO_TRIGGER
from acquisition.aravis._device import OpenedDevice, open_device
from acquisition.averaging import PATIENCE_S, average_frames
from acquisition.bench import BenchDevices
from acquisition.capture._runner import RunOperator, RunSummary, run_plan
from acquisition.errors import (
    CameraFeatureError,
    CaptureError,
    DeviceDisconnectedError,
    DeviceError,
    StreamInterruptedError,
)
from acquisition.session import verify
from acquisition.session._reader import Session
from hil_mocks.gige._settings import GigeFaults
from hil_mocks.gige._wire import ResendRequest
from hil_mocks.practice_bench import PracticeBench
from tests.acquisition.aravis_bench import (
    after_frames,
    camera_config,
    needs_aravis,
    opened,
    sent_image,
)
from tests.acquisition.fakes import ScriptedStage
from tests.acquisition.session_fixtures import bench_of, plan_of
from tests.busy_machine import BUSY_S
from tests.hil_mocks.gige_bench import gige_bench
from tests.hil_mocks.gige_client import wait_for

pytestmark = [needs_aravis, pytest.mark.waits]

QUICK = {"region_px": (0, 0, 96, 16), "frame_rate_hz": 200.0, "packet_size_bytes": 600}
"""About 200 frames a second, of six packets each."""

OFF = GigeFaults(is_dead=True, seed=9)
"""Marks a camera whose sockets are closed, too."""

Mishap = Callable[[PracticeBench], None]


@pytest.fixture
def bench() -> Iterator[PracticeBench]:
    with gige_bench() as opened_bench:
        yield opened_bench


def stall(bench: PracticeBench) -> None:
    bench.camera.faults = GigeFaults(is_stalled=True)


def die(bench: PracticeBench) -> None:
    bench.camera.faults = GigeFaults(is_dead=True)


def restart(bench: PracticeBench) -> None:
    bench.camera.restart()


def drop_control(bench: PracticeBench) -> None:
    bench.camera.drop_control()


def switch_off(bench: PracticeBench) -> None:
    bench.camera.faults = OFF
    bench.camera.close()


def recover(bench: PracticeBench) -> None:
    if bench.camera.faults == OFF:
        bench.camera.open()
    bench.camera.faults = GigeFaults()


@pytest.mark.slow
@pytest.mark.parametrize("loss_rate", [0.001, 0.01, 0.05])
def test_lost_packets_are_sent_again_and_every_average_succeeds(
    bench: PracticeBench, loss_rate: float
) -> None:
    with opened(bench, **QUICK) as camera:
        bench.camera.faults = GigeFaults(packet_loss_rate=loss_rate, seed=5)
        resent = [average_frames(camera, 4).resent_packets for _ in range(100)]
        # 100 averages of five frames of six packets; of 0.1 % of them none may be lost.
        expected = loss_rate * 100 * 5 * 6
        assert sum(resent) >= expected - 4 * sqrt(expected)


@pytest.mark.parametrize("is_said", [True, False])
def test_lost_packets_that_are_not_sent_again_end_in_an_error_with_the_count_and_the_reason(
    is_said: bool,
) -> None:
    lossy = GigeFaults(packet_loss_rate=0.01, resend_disabled=True, seed=1)
    with gige_bench(simulated__width_px=780, simulated__height_px=580) as bench, ExitStack() as its:
        if is_said:
            bench.camera.faults = GigeFaults(resend_disabled=True)
        camera = its.enter_context(opened(bench))
        assert camera.statistics().resends_packets is not is_said
        bench.camera.faults = lossy
        begin_s = time.monotonic()
        with pytest.raises(CaptureError) as refused:
            average_frames(camera, 10)
        assert refused.value.frames_refused["incomplete"] > 0
        assert (refused.value.resends_packets, refused.value.packets_resent) == (not is_said, 0)
        reason = "this camera does not resend" if is_said else "the camera resent no lost packet"
        assert reason in str(refused.value)
        assert time.monotonic() - begin_s < PATIENCE_S + BUSY_S
        recover(bench)
        assert average_frames(camera, 2).frames_used == 2


@pytest.mark.parametrize(
    "faults",
    [GigeFaults(duplicate_rate=0.2, seed=2), GigeFaults(reorder_rate=0.2, seed=2)],
    ids=["duplicated", "reordered"],
)
def test_packets_in_any_order_and_number_make_the_same_picture(
    bench: PracticeBench, faults: GigeFaults
) -> None:
    with opened(bench, packet_size_bytes=600) as camera:
        bench.camera.faults = faults
        camera.start()
        for _ in range(10):
            frame = camera.next_frame(1.0)
            assert frame.is_complete
            np.testing.assert_array_equal(frame.image_dn, sent_image(bench, camera, frame))


@pytest.mark.parametrize(
    ("faults", "why"),
    [
        (GigeFaults(corrupt_leader=True, resend_disabled=True), "incomplete"),
        (GigeFaults(missing_rows=2), "of the wrong shape"),
    ],
    ids=["corrupt leader", "missing rows"],
)
def test_frames_that_are_not_what_was_asked_for_never_enter_an_average(
    bench: PracticeBench, faults: GigeFaults, why: str
) -> None:
    with opened(bench, region_px=(0, 0, 96, 16), frame_rate_hz=200.0) as camera:
        bench.camera.faults = faults
        with pytest.raises(CaptureError) as refused:
            average_frames(camera, 10)
        assert why in refused.value.frames_refused
        recover(bench)
        assert average_frames(camera, 2).frames_used == 2


@pytest.mark.parametrize("is_resent", [True, False])
def test_an_unreadable_leader_never_brings_back_an_old_picture(
    bench: PracticeBench, is_resent: bool
) -> None:
    with opened(bench) as camera:
        average_frames(camera, 12)  # fills every buffer
        bench.camera.faults = GigeFaults(corrupt_leader=True, resend_disabled=not is_resent)
        camera.start()
        frames = [camera.next_frame(1.0) for _ in range(40)]
        complete = [frame for frame in frames if frame.is_complete]
        for frame in complete:
            np.testing.assert_array_equal(frame.image_dn, sent_image(bench, camera, frame))
        # Sent again, a leader is whole.
        assert bool(complete) == is_resent


@pytest.mark.parametrize("trigger", [NO_TRIGGER, "software"])
def test_a_late_packet_of_an_earlier_series_costs_a_few_frames_and_not_the_series(
    bench: PracticeBench, trigger: str
) -> None:
    with opened(bench, frame_rate_hz=20.0, trigger=trigger) as camera:
        camera.start()
        assert camera.next_frame(PATIENCE_S).is_complete
        # The camera's answer to a request for a packet of the 90th block, which it has no more.
        bench.camera._resend(ResendRequest(channel=0, block_id=90, first=1, last=1))
        frames = [camera.next_frame(PATIENCE_S) for _ in range(6)]
        assert sum(frame.is_complete for frame in frames) >= 4
        assert frames[-1].is_complete
        assert frames[-1].frame_id < 30


@pytest.mark.parametrize("is_present", [True, False])
def test_a_camera_with_or_without_a_thermometer_is_the_same_to_us(is_present: bool) -> None:
    with gige_bench() as bench:
        bench.camera.faults = GigeFaults(temperature_present=is_present)
        with opened(bench) as camera:
            assert average_frames(camera, 2).frames_used == 2


@pytest.mark.parametrize(
    "mishap",
    [
        pytest.param(stall, marks=pytest.mark.slow),
        pytest.param(die, marks=pytest.mark.slow),
        pytest.param(switch_off, marks=pytest.mark.slow),
        restart,
        drop_control,
    ],
)
def test_an_average_that_is_interrupted_fails_at_once_and_the_next_one_succeeds(
    bench: PracticeBench, mishap: Mishap
) -> None:
    with opened(bench) as camera:
        after_frames(camera, 4, lambda: mishap(bench))
        begin_s = time.monotonic()
        with pytest.raises(StreamInterruptedError):
            average_frames(camera, 10)
        assert time.monotonic() - begin_s < 1.0 + BUSY_S  # a second without frames
        recover(bench)
        settings = camera.settings
        averaged = average_frames(camera, 10)
        assert (averaged.frames_used, averaged.incomplete_frames) == (10, 0)
        assert camera.settings == settings
        assert camera.statistics().complete_frames >= 4 + 11


@pytest.mark.slow
def test_a_heartbeat_that_expires_is_noticed_and_the_camera_opened_again(
    bench: PracticeBench,
) -> None:
    with opened(bench) as camera:
        camera.start()
        bench.camera.faults = GigeFaults(heartbeat_lost=True)
        with pytest.raises(StreamInterruptedError):
            drain(camera, 10.0)
        recover(bench)
        assert average_frames(camera, 2).frames_used == 2


def test_no_handler_runs_in_the_thread_that_notices_the_loss(bench: PracticeBench) -> None:
    # One that still runs while the camera is closed makes that thread join itself: an abort.
    from gi.repository import GObject

    device = open_device(bench.camera.address)
    connection = _AravisConnection(device, camera_config(bench.camera.address))
    signal_id = GObject.signal_lookup("control-lost", device.device)
    assert signal_id > 0
    assert not GObject.signal_has_handler_pending(device.device, signal_id, 0, True)
    bench.camera.drop_control()
    wait_for(lambda: connection.is_lost)
    connection.close()


def test_settings_made_since_the_opening_come_back_with_the_camera(bench: PracticeBench) -> None:
    with opened(bench, region_px=(20, 6, 40, 32)) as camera:
        camera.set_exposure_us(2500.0)
        camera.set_gain_db(6.0)
        settings = camera.settings
        restart(bench)  # power-up: other exposure, gain, format, region and packet size
        assert bench.camera.value("ExposureTimeAbs") != 2500.0
        assert average_frames(camera, 2).frames_used == 2
        assert camera.settings == settings
        assert bench.camera.value("ExposureTimeAbs") == 2500.0
        assert bench.camera.value("OffsetX") == 20


def test_a_camera_that_comes_back_otherwise_is_an_error_that_names_the_feature(
    bench: PracticeBench,
) -> None:
    with opened(bench, exposure_us=20_000.0, frame_rate_hz=67.5) as camera:
        assert camera.settings.frame_rate_hz == pytest.approx(50)
        # As if the camera had been replaced by one of another black level.
        camera._settings = replace(camera.settings, black_level_dn=32.0)
        restart(bench)
        with pytest.raises(CameraFeatureError) as refused:
            camera.start()
        assert refused.value.feature == "BlackLevel"
        assert bench.camera.controller is None


def test_a_refused_setting_at_the_reconnection_is_named(bench: PracticeBench) -> None:
    with opened(bench) as camera:
        restart(bench)
        bench.camera.faults = GigeFaults(refused_registers=frozenset({"ExposureTimeAbs"}))
        with pytest.raises(CameraFeatureError) as refused:
            camera.start()
        assert refused.value.feature == "ExposureTimeAbs"
        recover(bench)
        assert average_frames(camera, 2).frames_used == 2


@pytest.mark.slow
def test_a_camera_that_stays_away_is_one_clear_error_within_the_stated_time(
    bench: PracticeBench,
) -> None:
    with opened(bench, reconnect_timeout_s=0.5) as camera:
        after_frames(camera, 4, lambda: die(bench))
        with pytest.raises(StreamInterruptedError):
            average_frames(camera, 10)
        begin_s = time.monotonic()
        with pytest.raises(DeviceDisconnectedError):
            camera.start()
        assert time.monotonic() - begin_s < 15 + BUSY_S
        with pytest.raises(DeviceError):
            camera.set_gain_db(1.0)
        recover(bench)
        assert average_frames(camera, 2).frames_used == 2


@pytest.mark.slow
@pytest.mark.parametrize("mishap", [stall, switch_off, restart])
def test_a_plan_goes_on_by_itself_when_the_camera_comes_back(
    bench: PracticeBench, tmp_path: Path, mishap: Mishap
) -> None:
    with opened(bench) as camera:
        # In mid-average: the second capture, after the skipped frame and one good one.
        after_frames(camera, 6, lambda: mishap(bench))
        started = camera.start

        def recovered_start() -> None:
            if camera.statistics().complete_frames > 5:
                recover(bench)
            started()

        camera.start = recovered_start  # type: ignore[method-assign]  # the cable is put back
        summary = run_plan_with(camera, tmp_path / "session")
    assert summary == RunSummary(captured=6, already_captured=0, skipped=0)
    session = Session(tmp_path / "session")
    assert verify(session.path).is_ok
    assert [record.frames_used for record in session.records] == [3] * 6
    errors = [event for event in session.events if event.kind == "error"]
    assert [event.facts["error"] for event in errors] == ["StreamInterruptedError"]
    assert errors[0].facts["index"] == 1


def test_a_plan_whose_camera_another_program_takes_ends_in_one_error_and_resumes(
    bench: PracticeBench, tmp_path: Path
) -> None:
    path = tmp_path / "session"
    others: list[OpenedDevice] = []

    def take_over() -> None:
        bench.camera.drop_control()
        others.append(open_device(bench.camera.address))

    with opened(bench, reconnect_timeout_s=0.0) as camera:
        after_frames(camera, 6, take_over)
        with pytest.raises(DeviceDisconnectedError):
            run_plan_with(camera, path)
    others.pop().close()
    assert len(Session(path).records) == 1
    with opened(bench) as camera:
        assert run_plan_with(camera, path).captured == 5
    assert Session(path).is_complete


def drain(camera: AravisCamera, limit_s: float) -> None:
    begin_s = time.monotonic()
    while time.monotonic() - begin_s < limit_s:
        camera.next_frame(3.0)  # longer than what it calls a stall


def run_plan_with(camera: AravisCamera, path: Path) -> RunSummary:
    devices = BenchDevices(config=bench_of(), camera=camera, stage=ScriptedStage())
    return run_plan(path, plan_of(), devices, RunOperator(name="test", place=lambda _: "ready"))
