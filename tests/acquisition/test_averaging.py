from collections.abc import Iterator
from itertools import chain, count

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames, average_frames
from acquisition.devices import Camera, Frame, FrameImage, Stage
from acquisition.errors import (
    CaptureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceTimeoutError,
)
from tests.acquisition.fakes import (
    COLS,
    ROWS,
    FakeClock,
    ScriptedCamera,
    ScriptedStage,
    frame,
    steady_frames,
)

Stack = NDArray[np.uint16]

stacks = hnp.arrays(
    np.uint16,
    st.tuples(st.integers(2, 9), st.just(ROWS), st.just(COLS)),
    elements=st.integers(0, 2**16 - 1),
)


def camera_of(stack: Stack) -> ScriptedCamera:
    return ScriptedCamera([frame(0, 1), *(frame(image, i) for i, image in enumerate(stack, 2))])


def average(camera: ScriptedCamera, frames_asked: int) -> AveragedFrames:
    return average_frames(camera, frames_asked, clock=camera.clock)


def test_the_fakes_are_what_the_protocols_ask_for() -> None:
    assert isinstance(ScriptedCamera(), Camera)
    assert isinstance(ScriptedStage(), Stage)


@pytest.mark.slow
@given(stacks)
def test_mean_and_variance_are_those_of_numpy_in_double(stack: Stack) -> None:
    averaged = average(camera_of(stack), len(stack))
    np.testing.assert_array_equal(averaged.mean_dn, stack.mean(0).astype(np.float32))
    # numpy subtracts a rounded mean; float32 keeps 24 bits
    np.testing.assert_allclose(averaged.variance_dn2, stack.var(0, ddof=1), rtol=1e-6, atol=1e-9)
    assert (averaged.min_dn, averaged.max_dn) == (stack.min(), stack.max())
    assert averaged.saturated_pixels == np.count_nonzero((stack >= 4095).any(0))


def test_two_frames_one_level_apart_have_variance_one_half() -> None:
    averaged = average(ScriptedCamera([frame(0, 1), frame(100, 2), frame(101, 3)]), 2)
    assert averaged.mean_dn == pytest.approx(100.5, abs=0)
    assert averaged.variance_dn2 == pytest.approx(0.5, abs=0)
    assert averaged.mean_dn.dtype == averaged.variance_dn2.dtype == np.float32


def test_full_scale_sixteen_bit_sums_stay_exact_over_a_thousand_frames() -> None:
    camera = ScriptedCamera(frame(65535 - i % 2, i + 1) for i in range(1001))
    averaged = average(camera, 1000)
    assert averaged.mean_dn == pytest.approx(65534.5, abs=0)
    assert averaged.variance_dn2 == pytest.approx(0.25 * 1000 / 999, rel=1e-7)  # closed form


@pytest.mark.parametrize("level", [4094, 65534])
def test_sums_of_squares_beyond_32_bits_are_carried(level: int) -> None:
    # Full twelve bits pass 2^32 after 256 frames; 65534 is beyond the format of the settings.
    levels = [level + i % 2 for i in range(700)]
    camera = ScriptedCamera(frame(dn, i) for i, dn in enumerate([0, *levels], 1))
    averaged = average(camera, 700)
    assert averaged.mean_dn == pytest.approx(level + 0.5, abs=0)
    assert averaged.variance_dn2 == pytest.approx(0.25 * 700 / 699, rel=1e-7)  # closed form


@pytest.mark.slow
@given(stacks, st.integers(0, 2**32))
def test_the_order_of_the_frames_does_not_matter(stack: Stack, seed: int) -> None:
    shuffled = np.random.default_rng(seed).permutation(stack)
    one, other = average(camera_of(stack), len(stack)), average(camera_of(shuffled), len(stack))
    np.testing.assert_array_equal(one.mean_dn, other.mean_dn)
    np.testing.assert_array_equal(one.variance_dn2, other.variance_dn2)


def test_eight_bit_frames_average_as_well() -> None:
    images = [np.full((ROWS, COLS), level, np.uint8) for level in (0, 255, 254)]
    averaged = average(ScriptedCamera(frame(im, i) for i, im in enumerate(images, 1)), 2)
    assert averaged.mean_dn == pytest.approx(254.5, abs=0)


def test_the_first_frame_after_the_start_is_skipped_whatever_it_is() -> None:
    averaged = average(ScriptedCamera([frame(4095, 7), frame(10, 8), frame(10, 9)]), 2)
    assert (averaged.max_dn, averaged.saturated_pixels) == (10, 0)
    assert (averaged.first_timestamp_ns, averaged.last_timestamp_ns) == (160_000_000, 180_000_000)


def test_a_lost_frame_is_replaced_and_counted() -> None:
    camera = ScriptedCamera(
        [frame(0, 1), frame(10, 2), frame(0, 3, is_complete=False), frame(12, 4)]
    )
    averaged = average(camera, 2)
    assert averaged.mean_dn == pytest.approx(11, abs=0)
    assert (averaged.frames_used, averaged.incomplete_frames) == (2, 1)


def test_a_repeated_id_is_not_averaged_twice() -> None:
    camera = ScriptedCamera([frame(0, 1), frame(0, 1), frame(10, 2), frame(10, 2), frame(20, 3)])
    assert average(camera, 2).mean_dn == pytest.approx(15, abs=0)


def test_a_frame_id_that_wraps_from_65535_to_1_is_a_new_frame() -> None:
    camera = ScriptedCamera([frame(0, 65534), frame(10, 65535), frame(20, 1)])
    assert average(camera, 2).mean_dn == pytest.approx(15, abs=0)


def test_a_frame_of_the_wrong_shape_is_replaced() -> None:
    transposed = np.full((COLS, ROWS), 99, np.uint16)
    camera = ScriptedCamera([frame(0, 1), frame(transposed, 2), frame(10, 3), frame(20, 4)])
    assert average(camera, 2).mean_dn == pytest.approx(15, abs=0)


def test_lost_frames_without_end_are_an_error_not_a_shorter_average() -> None:
    lost = (frame(0, i, is_complete=False) for i in count(3))
    camera = ScriptedCamera(chain([frame(0, 1), frame(5, 2)], lost))
    with pytest.raises(CaptureError) as refused:
        average(camera, 3)
    assert (refused.value.frames_complete, refused.value.frames_asked) == (1, 3)
    # 3 s at 50 frames a second from the frame before; the count may be off by a rounding
    assert refused.value.frames_refused["incomplete"] == pytest.approx(150, abs=2)
    assert not camera.is_streaming


def test_losses_of_a_moment_end_no_capture_however_many_frames_they_cost() -> None:
    # 2.8 s of torn frames at 50 frames a second: fourteen times as many as were asked for
    torn = [frame(0, i, is_complete=False) for i in range(2, 142)]
    good = [frame(10 + i % 2, i) for i in range(142, 152)]
    averaged = average(ScriptedCamera([frame(0, 1), *torn, *good]), 10)
    assert (averaged.frames_used, averaged.incomplete_frames) == (10, 140)


def test_a_stream_that_loses_nearly_every_frame_is_given_up() -> None:
    # A good frame each second, and 49 torn ones: progress, but a network to be mended.
    script = (frame(5, i, is_complete=i % 50 == 10) for i in count(1))
    with pytest.raises(CaptureError) as refused:
        average(ScriptedCamera(script), 10)
    # from 3 s on, as more than two frames were refused for each one asked for
    assert refused.value.frames_complete == 3
    assert 3 * 50 - 5 <= refused.value.frames_refused["incomplete"] <= 3 * 50


def test_a_camera_that_falls_mute_in_mid_average_is_an_error_with_the_count() -> None:
    camera = ScriptedCamera([frame(0, 1), frame(5, 2), frame(5, 3)])
    with pytest.raises(CaptureError) as caught:
        average(camera, 10)
    assert (caught.value.frames_complete, caught.value.frames_asked) == (2, 10)
    assert isinstance(caught.value.__cause__, DeviceTimeoutError)
    assert not camera.is_streaming
    # three frames at 50 Hz, then 3 s without one
    assert camera.clock.now_s - 100.0 == pytest.approx(3 / 50 + 3)


def test_a_machine_that_reaches_a_tenth_of_the_frame_rate_gets_its_average() -> None:
    camera = slow_camera(0.2)
    assert average(camera, 10).frames_used == 10
    assert camera.clock.now_s - 100.0 > 11 * 0.2


def test_a_program_that_was_suspended_takes_the_frames_that_wait_for_it() -> None:
    clock = FakeClock()

    def pause() -> Iterator[Frame]:
        yield from (frame(10, i) for i in range(1, 4))
        clock.now_s += 30.0  # a laptop that slept
        yield from (frame(10, i, is_complete=i > 5) for i in range(4, 20))

    averaged = average(ScriptedCamera(pause(), clock=clock), 10)
    assert (averaged.frames_used, averaged.incomplete_frames) == (10, 2)


def test_an_average_that_takes_minutes_is_given_up() -> None:
    camera = slow_camera(2.9)
    with pytest.raises(CaptureError) as late:
        average(camera, 1000)
    assert late.value.frames_refused == {}
    # 60 s + 20 (N + 1) / fps, which a frame of 2.9 s may overrun
    assert 0 <= camera.clock.now_s - 100.0 - (60 + 20 * 1001 / 50) <= 2.9 + 1 / 50


@pytest.mark.parametrize(
    ("script", "remedy"),
    [
        ([], "cable"),
        ([frame(0, i, is_complete=False) for i in range(1, 400)], "standoff doctor"),
        ([frame(0, 1)] * 400, "restart the camera"),
    ],
    ids=["mute", "torn", "frozen"],
)
def test_a_failed_capture_says_what_to_do(script: list[Frame], remedy: str) -> None:
    with pytest.raises(CaptureError, match=remedy) as failed:
        average(ScriptedCamera(script), 10)
    assert str(failed.value).endswith("then run again")


@pytest.mark.parametrize(
    ("resends", "per_frame", "told"),
    [
        (False, 0, "this camera does not resend lost packets"),
        (True, 0, "the camera resent no lost packet"),
        (True, 3, "which was not enough"),
        (None, 0, "no good frame"),
    ],
)
def test_an_average_that_failed_for_lost_packets_says_whether_they_were_sent_again(
    resends: bool | None, per_frame: int, told: str
) -> None:
    camera = ScriptedCamera([frame(0, i, is_complete=False) for i in range(1, 400)])
    camera.resends_packets, camera.resent_per_frame = resends, per_frame
    with pytest.raises(CaptureError, match=told) as failed:
        average(camera, 10)
    assert failed.value.resends_packets is resends
    came = failed.value.frames_refused["incomplete"]
    assert failed.value.packets_resent == per_frame * (came + 1)  # and of the skipped one
    assert f"only 0 of 10 frames ({came} came: {came} incomplete)" in str(failed.value)
    for remedy in ("MTU 9000", "net.core.rmem_max", "camera.bandwidth_limit_bytes_per_s", "cable"):
        assert remedy in str(failed.value)
    assert "\n" not in str(failed.value)


def slow_camera(frame_s: float) -> ScriptedCamera:
    """A camera set to 50 frames a second whose machine takes ``frame_s`` more for each."""
    clock = FakeClock()

    def crawl() -> Iterator[Frame]:
        for item in steady_frames():
            clock.now_s += frame_s
            yield item

    return ScriptedCamera(crawl(), clock=clock)


def test_a_camera_that_is_gone_says_so_itself_even_when_it_cannot_be_stopped() -> None:
    camera = ScriptedCamera([frame(0, 1), DeviceDisconnectedError("cable out")])
    camera.stop_error = DeviceError("no answer")
    with pytest.raises(DeviceDisconnectedError) as caught:
        average(camera, 2)
    assert caught.value.__notes__ == ["stopping the stream failed too: no answer"]


def test_the_stream_is_stopped_on_a_keyboard_interrupt() -> None:
    camera = ScriptedCamera([frame(0, 1), KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        average(camera, 2)
    assert not camera.is_streaming


def test_resent_packets_are_those_of_this_capture_alone() -> None:
    camera = ScriptedCamera()
    camera.resent_per_frame = 3
    average(camera, 4)
    assert average(camera, 4).resent_packets == 3 * 5  # four frames and the skipped one


def test_kept_frames_are_exactly_those_of_the_average() -> None:
    kept: list[FrameImage] = []
    camera = ScriptedCamera([frame(9, 1), frame(10, 2), frame(10, 2), frame(12, 3)])
    averaged = average_frames(camera, 2, keep_frame=kept.append, clock=camera.clock)
    np.testing.assert_array_equal(np.mean(kept, axis=0), averaged.mean_dn)
    assert len(kept) == 2


@pytest.mark.parametrize("frames_asked", [-1, 0, 1, 10_001])
def test_a_number_of_frames_without_a_variance_or_an_exact_sum_is_refused(
    frames_asked: int,
) -> None:
    camera = ScriptedCamera()
    with pytest.raises(ValueError):
        average(camera, frames_asked)
    assert camera.starts == 0
