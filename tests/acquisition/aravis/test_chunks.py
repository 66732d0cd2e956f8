"""Exposure, counter and time stamp that a camera states with each frame, and triggers."""

from typing import get_args

import numpy as np
import pytest

from acquisition.averaging import average_frames
from acquisition.errors import CameraFeatureError, CaptureError, DeviceTimeoutError
from hil_mocks.gige._features import Maker
from hil_mocks.gige._settings import FrameRequest, GigeFaults
from hil_mocks.practice_bench import PracticeBench
from tests.acquisition.aravis_bench import needs_aravis, opened
from tests.hil_mocks.gige_bench import gige_bench

pytestmark = needs_aravis

CHUNKED: tuple[Maker, ...] = ("basler", "flir", "hikrobot", "ids")
"""Simulated cameras that state the exposure; the first in chunk blocks of GigE Vision 1."""


def mean_of_frames(bench: PracticeBench, indices: range, exposure_us: float) -> np.ndarray:
    """Mean of frames as the sensor made them, of the latest acquisition."""
    frames = [
        bench.source.levels_dn(
            FrameRequest(
                acquisition=bench.camera.acquisitions,
                index=index,
                exposure_us=exposure_us,
                gain_db=bench.camera.value("Gain"),
                black_level_dn=bench.camera.value("BlackLevel"),
            )
        )
        for index in indices
    ]
    return np.asarray(np.mean(frames, axis=0, dtype=np.float64))


@pytest.mark.slow
@pytest.mark.parametrize("maker", CHUNKED)
def test_frames_state_their_exposure_and_their_picture_is_that_without_chunks(
    maker: Maker,
) -> None:
    with gige_bench(maker=maker) as bench, opened(bench) as camera:
        averaged = average_frames(camera, 3)
        np.testing.assert_allclose(
            averaged.mean_dn, mean_of_frames(bench, range(1, 4), 4000.0), rtol=1e-6
        )
        camera.set_exposure_us(5000.0)
        camera.start()
        assert camera.next_frame(1.0).exposure_us == 5000.0


def test_a_camera_without_chunks_and_one_that_is_not_asked_state_no_exposure() -> None:
    with gige_bench() as bench, opened(bench) as camera:
        camera.start()
        assert camera.next_frame(1.0).exposure_us is None
    with gige_bench(maker="flir") as bench, opened(bench, chunk_data=False) as camera:
        camera.start()
        assert camera.next_frame(1.0).exposure_us is None


@pytest.mark.slow
@pytest.mark.parametrize("maker", CHUNKED)
def test_a_frame_with_another_exposure_never_enters_a_mean(maker: Maker) -> None:
    with gige_bench(maker=maker) as bench, opened(bench) as camera:
        average_frames(camera, 2)
        bench.camera.faults = GigeFaults(exposure_delay_frames=3)
        camera.set_exposure_us(8000.0)
        averaged = average_frames(camera, 3)
        # The first frame is skipped in any case, the second and third are those refused.
        np.testing.assert_allclose(
            averaged.mean_dn, mean_of_frames(bench, range(3, 6), 8000.0), rtol=1e-6
        )


AMPLIFIED: tuple[Maker, ...] = ("flir", "hikrobot")
"""Simulated cameras that state the gain as well."""


@pytest.mark.slow
@pytest.mark.parametrize("maker", AMPLIFIED)
def test_a_frame_with_another_gain_never_enters_a_mean(maker: Maker) -> None:
    with gige_bench(maker=maker) as bench, opened(bench) as camera:
        average_frames(camera, 2)
        bench.camera.faults = GigeFaults(gain_delay_frames=3)
        camera.set_gain_db(6.0)
        averaged = average_frames(camera, 3)
        np.testing.assert_allclose(
            averaged.mean_dn, mean_of_frames(bench, range(3, 6), 4000.0), rtol=1e-6
        )
        assert averaged.stale_frames == 2  # the first is skipped in any case
        camera.start()
        assert camera.next_frame(1.0).gain == 6.0


@pytest.mark.slow
def test_a_camera_that_never_takes_over_the_gain_is_an_error_with_the_count() -> None:
    with gige_bench(maker="flir") as bench, opened(bench) as camera:
        average_frames(camera, 2)
        bench.camera.faults = GigeFaults(gain_delay_frames=1000)
        camera.set_gain_db(6.0)
        with pytest.raises(CaptureError, match="switch its automatic gain") as refused:
            average_frames(camera, 3)
        # A busy machine drops packets: such frames say nothing of the gain.
        assert refused.value.frames_refused.keys() - {"incomplete"} == {"with a different gain"}


@pytest.mark.slow
@pytest.mark.parametrize("maker", ["basler", "ids"])
def test_a_camera_whose_gain_is_by_another_name_or_unit_states_none(maker: Maker) -> None:
    with gige_bench(maker=maker) as bench, opened(bench) as camera:
        camera.start()
        assert camera.next_frame(1.0).gain is None


@pytest.mark.slow
def test_a_camera_that_never_takes_over_the_exposure_is_an_error_with_the_count() -> None:
    with gige_bench(maker="flir") as bench, opened(bench) as camera:
        average_frames(camera, 2)
        bench.camera.faults = GigeFaults(exposure_delay_frames=1000)
        camera.set_exposure_us(8000.0)
        with pytest.raises(CaptureError) as refused:
            average_frames(camera, 2)
        # It is given time to take it over: as long as to any camera without a good frame.
        # A busy machine drops packets: such frames say nothing of the exposure.
        assert refused.value.frames_refused.keys() - {"incomplete"} == {"with a different exposure"}
        assert refused.value.frames_refused["with a different exposure"] >= 6
        assert "switch its automatic exposure and sequencer off" in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("maker", get_args(Maker))
def test_with_the_software_trigger_each_frame_is_asked_for(maker: Maker) -> None:
    with gige_bench(maker=maker) as bench, opened(bench, trigger="software") as camera:
        assert camera.settings.features["TriggerSource"] == "Software"
        averaged = average_frames(camera, 3)
        np.testing.assert_allclose(
            averaged.mean_dn, mean_of_frames(bench, range(1, 4), 4000.0), rtol=1e-6
        )
        assert camera.statistics().complete_frames == 4  # and none that nobody asked for


@pytest.mark.slow
def test_with_a_line_as_the_trigger_frames_come_with_its_pulses_and_silence_is_no_stall() -> None:
    with gige_bench() as bench, opened(bench, trigger="Line1", trigger_edge="falling") as camera:
        assert camera.settings.features["TriggerActivation"] == "FallingEdge"
        camera.start()
        with pytest.raises(DeviceTimeoutError):
            camera.next_frame(1.2)  # longer than a stall
        bench.camera.pulse_line("Line2")
        with pytest.raises(DeviceTimeoutError):
            camera.next_frame(0.2)
        bench.camera.pulse_line("Line1")
        assert camera.next_frame(1.0).is_complete


def test_a_trigger_that_a_camera_does_not_have_is_refused_with_those_it_has() -> None:
    with (
        gige_bench(maker="hikrobot") as bench,
        pytest.raises(CameraFeatureError, match="Line0, Software") as refused,
        opened(bench, trigger="Line7"),
    ):
        pass
    assert refused.value.feature == "TriggerSource"


def test_without_a_trigger_one_that_was_left_on_is_switched_off() -> None:
    with gige_bench(maker="ids") as bench:
        with opened(bench, trigger="Line0"):
            pass
        with opened(bench) as camera:
            assert average_frames(camera, 2).frames_used == 2
