import numpy as np
from hypothesis import given, strategies as st

from standoff.console.devices.frame_broadcaster import FrameBroadcaster
from tests.acquisition.fakes import SETTINGS, frame


def test_the_newest_frame_is_shown_and_counted() -> None:
    broadcaster = FrameBroadcaster(clock=iter(np.arange(100) * 0.02).__next__)
    for number in (1, 2, 3):
        broadcaster.publish(frame(100 * number, number), SETTINGS)
    latest = broadcaster.latest
    assert latest is not None
    assert (latest.sequence, latest.image_dn[0, 0]) == (3, 300)
    counts = broadcaster.counts
    assert (counts.complete, counts.incomplete, counts.lost) == (3, 0, 0)
    assert abs(counts.rate_hz - 50.0) < 1e-6


def test_frames_that_never_came_are_counted_by_their_ids() -> None:
    broadcaster = FrameBroadcaster()
    for number in (1, 2, 5):
        broadcaster.publish(frame(1, number), SETTINGS)
    broadcaster.publish(frame(1, 6, is_complete=False), SETTINGS)
    assert (
        broadcaster.counts.lost,
        broadcaster.counts.incomplete,
        broadcaster.counts.complete,
    ) == (2, 1, 3)


def test_a_stream_that_begins_anew_has_lost_nothing() -> None:
    broadcaster = FrameBroadcaster()
    broadcaster.publish(frame(1, 900), SETTINGS)
    broadcaster.stream_began()
    broadcaster.publish(frame(1, 3), SETTINGS)
    assert broadcaster.counts.lost == 0


def test_ids_wrap_at_16_bits_without_zero() -> None:
    broadcaster = FrameBroadcaster()
    for number in (65534, 65535, 1, 2):
        broadcaster.publish(frame(1, number), SETTINGS)
    assert broadcaster.counts.lost == 0


@given(missing=st.sets(st.integers(2, 99), max_size=50))
def test_as_many_are_lost_as_were_left_out(missing: set[int]) -> None:
    broadcaster = FrameBroadcaster()
    for number in range(1, 101):
        if number not in missing:
            broadcaster.publish(frame(1, number), SETTINGS)
    assert broadcaster.counts.lost == len(missing)


def test_listeners_are_called_until_they_end() -> None:
    broadcaster, heard = FrameBroadcaster(), []
    end = broadcaster.subscribe(lambda: heard.append(1))
    broadcaster.publish(frame(1, 1), SETTINGS)
    end()
    end()
    broadcaster.publish(frame(1, 2), SETTINGS)
    assert heard == [1]
    assert broadcaster.wait_newer(2, 0.0) is None
    newer = broadcaster.wait_newer(1, 0.0)
    assert newer is not None
    assert newer.sequence == 2
