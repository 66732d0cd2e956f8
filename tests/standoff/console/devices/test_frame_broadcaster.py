import numpy as np
from hypothesis import given, strategies as st

from standoff.console.devices.frame_broadcaster import FrameBoard
from tests.acquisition.fakes import SETTINGS, frame


def test_the_newest_frame_is_shown_and_counted() -> None:
    board = FrameBoard(clock=iter(np.arange(100) * 0.02).__next__)
    for number in (1, 2, 3):
        board.publish(frame(100 * number, number), SETTINGS)
    latest = board.latest
    assert latest is not None
    assert (latest.sequence, latest.image_dn[0, 0]) == (3, 300)
    counts = board.counts
    assert (counts.complete, counts.incomplete, counts.lost) == (3, 0, 0)
    assert abs(counts.rate_hz - 50.0) < 1e-6


def test_frames_that_never_came_are_counted_by_their_ids() -> None:
    board = FrameBoard()
    for number in (1, 2, 5):
        board.publish(frame(1, number), SETTINGS)
    board.publish(frame(1, 6, is_complete=False), SETTINGS)
    assert (board.counts.lost, board.counts.incomplete, board.counts.complete) == (2, 1, 3)


def test_a_stream_that_begins_anew_has_lost_nothing() -> None:
    board = FrameBoard()
    board.publish(frame(1, 900), SETTINGS)
    board.stream_began()
    board.publish(frame(1, 3), SETTINGS)
    assert board.counts.lost == 0


def test_ids_wrap_at_16_bits_without_zero() -> None:
    board = FrameBoard()
    for number in (65534, 65535, 1, 2):
        board.publish(frame(1, number), SETTINGS)
    assert board.counts.lost == 0


@given(missing=st.sets(st.integers(2, 99), max_size=50))
def test_as_many_are_lost_as_were_left_out(missing: set[int]) -> None:
    board = FrameBoard()
    for number in range(1, 101):
        if number not in missing:
            board.publish(frame(1, number), SETTINGS)
    assert board.counts.lost == len(missing)


def test_listeners_are_called_until_they_end() -> None:
    board, heard = FrameBoard(), []
    end = board.subscribe(lambda: heard.append(1))
    board.publish(frame(1, 1), SETTINGS)
    end()
    end()
    board.publish(frame(1, 2), SETTINGS)
    assert heard == [1]
    assert board.wait_newer(2, 0.0) is None
    newer = board.wait_newer(1, 0.0)
    assert newer is not None
    assert newer.sequence == 2
