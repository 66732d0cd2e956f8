"""Pictures over a link whose every byte is accounted for, in a time of its own."""

import heapq
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from standoff.console.frames import FORMS, LiveFrame, PictureEncoder, PictureForm
from standoff.console.web._link import (
    BUSY_S,
    FIRST_BYTES,
    LATE_S,
    LEAST_S,
    NO_TIME_S,
    PERIOD_S,
    PICTURES,
    Link,
    PicturePace,
)
from tests.acquisition.fakes import SETTINGS

TICK_S = 0.005
FRAME = LiveFrame(
    image_dn=np.zeros((580, 780), np.uint16), sequence=1, received_s=0.0, settings=SETTINGS
)
PING_S, TEXT_BYTES_PER_S = 0.5, 8e3


@given(
    rate=st.floats(2e4, 2e6),
    round_trip_s=st.floats(0.0, 0.5),
    sizes=st.lists(st.integers(5_000, 500_000), min_size=1, max_size=20),
    in_hand_s=st.floats(0.0, 0.2),
)
def test_the_rate_of_a_link_is_told_from_pictures_one_after_the_other(
    rate: float, round_trip_s: float, sizes: list[int], in_hand_s: float
) -> None:
    link, now_s, times_s = Link(), 10.0, []
    link.note_round_trip(round_trip_s)
    link.note_round_trip(round_trip_s + 0.3)  # one that waited
    for sequence, size in enumerate(sizes):
        link.note_sent(sequence, size, now_s)
        now_s += round_trip_s + size / rate + in_hand_s
        link.note_arrived(sequence, now_s, in_hand_s=in_hand_s)
        times_s.append(size / rate)
    size, rates = sum(sizes[-PICTURES:]), link.rates
    assert rates is not None
    for found, others_s, least_s in (
        (rates.surely, -round_trip_s, LEAST_S),
        (rates.probably, 0.0, LEAST_S),
        (rates.possibly, BUSY_S, NO_TIME_S),
    ):
        took_s = sum(max(time_s - others_s, least_s) for time_s in times_s[-PICTURES:])
        assert found == pytest.approx(size / took_s, rel=1e-6)
    assert link.under_way == link.under_way_bytes == 0


def test_pictures_close_behind_one_another_have_the_link_in_turn() -> None:
    link = Link()
    link.note_round_trip(0.2)
    for sequence in range(3):
        link.note_sent(sequence, 100_000, 1.0)  # at 1 MB/s a tenth of a second each
    assert (link.under_way, link.under_way_bytes) == (3, 300_000)
    for sequence in range(3):
        link.note_arrived(sequence, 1.3 + 0.1 * sequence)
    assert link.rates is not None
    assert link.rates.probably == pytest.approx(1e6)
    assert link.rates.surely == pytest.approx(3e5 / (0.3 + 0.4 + 0.5))


def test_a_page_that_was_asleep_is_sent_pictures_again_but_ever_more_patiently() -> None:
    link = Link()
    given_up_s = []
    link.note_sent(1, 1000, 0.0)
    sent_s = 0.0
    for now_s in np.arange(0.0, 20.0, 0.01).tolist():
        link.give_up_late(now_s)
        if link.under_way == 0:
            given_up_s.append(now_s - sent_s)
            link.note_sent(1, 1000, sent_s := now_s)
    assert given_up_s == pytest.approx([LATE_S, 2 * LATE_S, 4 * LATE_S], abs=0.02)
    link.note_arrived(1, 20.0)
    link.note_sent(2, 1000, 20.0)
    link.give_up_late(20.0 + 1.01 * LATE_S)
    assert link.under_way == 0


@dataclass
class Network:
    """A link without a limit of what waits in it, and a page that draws at once."""

    rate: float
    one_way_s: float
    detail: float
    free_s: float = 0.0
    coming: list[tuple[float, int, str, float]] = field(default_factory=list)
    shown: list[tuple[float, float, PictureForm]] = field(default_factory=list)
    answers_s: list[float] = field(default_factory=list)

    def send(self, now_s: float, size: float) -> float:
        """Return when the last byte is on the page."""
        self.free_s = max(self.free_s, now_s) + size / self.rate
        return self.free_s + self.one_way_s


class Sizes(PictureEncoder):
    """Sizes as expected, of scenes that have more or less detail."""

    def __init__(self, detail: float) -> None:
        super().__init__()
        self.detail = detail

    def size_bytes(self, frame: LiveFrame, form: PictureForm) -> float:
        return (self.detail if form.quality else 1.0) * frame.image_dn.size * form.bytes_per_px


def run(network: Network, seconds: float, *, then_rate: float | None = None) -> None:
    """Show a camera's pictures for some time; halfway the link may change its rate."""
    link, encoder = Link(), Sizes(network.detail)
    pace, sequence, asked_s = PicturePace(link, encoder), 0, 0.0
    events = network.coming
    for tick in range(round(seconds / TICK_S)):
        now_s = tick * TICK_S
        if then_rate is not None and now_s >= seconds / 2:
            network.rate = then_rate
        while events and events[0][0] <= now_s:
            _, number, kind, since_s = heapq.heappop(events)
            if kind == "drawn":
                link.note_arrived(number, now_s)
            else:
                link.note_round_trip(since_s)
        network.free_s = max(network.free_s, now_s) + TICK_S * TEXT_BYTES_PER_S / network.rate
        if now_s - asked_s >= PING_S:
            asked_s = now_s
            answered_s = network.send(now_s + network.one_way_s, 60)
            network.answers_s.append(answered_s - now_s)
            # The page tells what it measured with its next question.
            heapq.heappush(events, (answered_s + network.one_way_s, 0, "asked", answered_s - now_s))
        form = pace.form_now(replace(FRAME, sequence=sequence + 1), now_s)
        if form is not None:
            sequence += 1
            size = encoder.size_bytes(FRAME, form)
            link.note_sent(sequence, int(size), now_s)
            drawn_s = network.send(now_s, size)
            network.shown.append((now_s, drawn_s - now_s, form))
            heapq.heappush(events, (drawn_s + network.one_way_s, sequence, "drawn", 0.0))


@pytest.mark.parametrize("detail", [0.1, 0.5, 1.0, 2.0])
@pytest.mark.parametrize(
    ("rate", "one_way_s", "least_hz", "most_s"),
    [
        (1e6, 0.0, 8, 0.3),
        (1e6, 0.02, 8, 0.3),
        (1e6, 0.1, 8, 0.4),
        (60e3, 0.1, 1, 1.0),
        (60e3, 0.0, 1, 0.8),
    ],
)
def test_rate_and_size_of_pictures_follow_the_link(
    rate: float, one_way_s: float, least_hz: float, most_s: float, detail: float
) -> None:
    network = Network(rate, one_way_s, detail)
    run(network, 20.0)
    settled = [each for each in network.shown if each[0] > 5.0]
    assert len(settled) / 15.0 >= least_hz
    assert np.median([latency_s for _, latency_s, _ in settled]) < most_s
    assert max(network.answers_s) < 1.0  # STOP is answered in time, from the first picture on


def test_a_fast_link_carries_pictures_as_they_are_at_the_full_rate() -> None:
    for detail in (0.05, 1.0, 2.0):
        network = Network(100e6, 0.0005, detail)
        run(network, 6.0)
        settled = [each for each in network.shown if each[0] > 3.0]
        assert {form for _, _, form in settled} == {FORMS[0]}
        assert len(settled) / 3.0 == pytest.approx(1 / PERIOD_S, rel=0.2)


@pytest.mark.parametrize(("rate", "then_rate"), [(2e6, 60e3), (60e3, 50e6)])
def test_a_link_that_changes_is_followed_down_and_up(rate: float, then_rate: float) -> None:
    changed, same = Network(rate, 0.02, 1.0), Network(then_rate, 0.02, 1.0)
    run(changed, 60.0, then_rate=then_rate)
    run(same, 60.0)
    last, usual = (
        np.mean([FORMS.index(form) for sent_s, _, form in each.shown if sent_s > 55.0])
        for each in (changed, same)
    )
    assert abs(last - usual) <= 1  # a better form is taken when there is room for it


def test_the_first_picture_is_small() -> None:
    encoder = Sizes(1.0)
    form = PicturePace(Link(), encoder).form_now(FRAME, 0.0)
    assert form is not None
    assert encoder.size_bytes(FRAME, form) <= FIRST_BYTES
