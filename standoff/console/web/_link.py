"""How fast the link to a page is, and when the next picture goes over it, and in which form."""

from collections import deque
from dataclasses import dataclass

from standoff.console.frames import FORMS, LiveFrame, PictureEncoder, PictureForm

PICTURES = 12
"""The rate is that of so many pictures, the last ones: it falls at once, and rises within them."""

BUSY_S = 0.025
"""So much of a picture's time may be the computers' and not the link's."""

LEAST_S, NO_TIME_S = 0.002, 1e-6

ROUND_TRIPS = 20
"""The shortest of so many counts: the others waited behind pictures."""

LATE_S = 2.0
"""After this time a picture is waited for no longer, so that a page that was asleep recovers."""


@dataclass(slots=True)
class _Sent:
    sequence: int
    size_bytes: int
    sent_s: float


@dataclass(frozen=True, slots=True)
class _Carried:
    size_bytes: int
    way_s: float
    took_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Rates:
    """What a link carries in bytes per second, by what is taken for its time.

    ``surely`` is all of it, ``probably`` what is left without the round trip, ``possibly`` what is
    left without the computers' as well. ``largest_bytes`` is the largest picture that tells so.
    """

    largest_bytes: int
    surely: float
    probably: float
    possibly: float


class Link:
    """The connection to one page: what is under way on it, and what it carries.

    A picture arrives after the round trip and the time that its bytes take. That is told apart
    because the page measures the round trip with questions of a few bytes, and tells how long it
    had a picture in hand itself. All times are of one monotonic clock, in seconds.
    """

    def __init__(self) -> None:
        self._under_way: deque[_Sent] = deque()
        self._carried: deque[_Carried] = deque(maxlen=PICTURES)
        self._round_trips_s: deque[float] = deque(maxlen=ROUND_TRIPS)
        self._arrived_s = float("-inf")
        self._patience_s = LATE_S

    @property
    def rates(self) -> Rates | None:
        """What the link carries; None before it has carried a picture."""
        if not self._carried:
            return None
        size = sum(each.size_bytes for each in self._carried)
        return Rates(
            largest_bytes=max(each.size_bytes for each in self._carried),
            surely=size / sum(max(each.way_s, LEAST_S) for each in self._carried),
            probably=size / sum(max(each.took_s, LEAST_S) for each in self._carried),
            possibly=size / sum(max(each.took_s - BUSY_S, NO_TIME_S) for each in self._carried),
        )

    @property
    def round_trip_s(self) -> float:
        """Of a few bytes, there and back; 0 while it is not known."""
        return min(self._round_trips_s, default=0.0)

    @property
    def under_way(self) -> int:
        """Number of pictures that have been sent and have not arrived, as far as is known."""
        return len(self._under_way)

    @property
    def under_way_bytes(self) -> int:
        """Size of the pictures under way."""
        return sum(each.size_bytes for each in self._under_way)

    def note_round_trip(self, took_s: float) -> None:
        """Take in how long a question of the page took to be answered."""
        self._round_trips_s.append(took_s)

    def note_sent(self, sequence: int, size_bytes: int, now_s: float) -> None:
        """Take in that a picture was handed to the connection."""
        self._under_way.append(_Sent(sequence, size_bytes, now_s))

    def note_arrived(self, sequence: int, now_s: float, *, in_hand_s: float = 0.0) -> None:
        """Take in that the page has drawn a picture, and so has all before it.

        It had the picture in hand for a while between its arrival and this word.
        """
        while self._under_way and self._under_way[0].sequence <= sequence:
            self._arrive(self._under_way.popleft(), now_s - in_hand_s)
            self._patience_s = LATE_S

    def give_up_late(self, now_s: float) -> None:
        """Wait no longer for pictures that are under way for too long; the link is not known."""
        if self._under_way and now_s - self._under_way[0].sent_s > self._patience_s:
            self._under_way.clear()
            self._patience_s *= 2.0  # perhaps it was not the page that was asleep
            self._carried.clear()

    def _arrive(self, picture: _Sent, arrived_s: float) -> None:
        # Its bytes followed those of the picture before it, or had the link to themselves.
        began_s = max(picture.sent_s + self.round_trip_s, self._arrived_s)
        self._carried.append(
            _Carried(picture.size_bytes, arrived_s - picture.sent_s, arrived_s - began_s)
        )
        self._arrived_s = arrived_s


PERIOD_S = 1 / 30
"""No page is sent pictures more often."""

AT_ONCE = 2
"""Pictures under way where there is no round trip to speak of."""

SHARE = 0.75
"""Of the link, for pictures: figures and answers go over it, too."""

QUEUE_S = 0.1
"""What may wait on the way: so long is the answer to STOP delayed by pictures, if by anything."""

FIRST_BYTES = 16 * 1024
"""The first picture is of this size at the most, whatever the link."""

ROOM = 1.2
"""A better form is taken once the link carries so many times what it needs."""

SURELY_S, GROWTH = 0.4, 4.0
"""No picture takes longer, even if all the time of those before it was that of their bytes; or it
is not much larger than they were."""


class PicturePace:
    """Decides for one page when a frame is sent to it, and in which form."""

    def __init__(self, link: Link, encoder: PictureEncoder) -> None:
        self._link = link
        self._encoder = encoder
        self._form = FORMS[-1]
        self._sent_s = float("-inf")

    def form_now(self, frame: LiveFrame, now_s: float) -> PictureForm | None:
        """The form in which a frame is sent now; None if it is too early for the next picture."""
        if now_s - self._sent_s < 0.9 * PERIOD_S:  # frames arrive at times of their own
            return None
        self._link.give_up_late(now_s)
        form = self._fitting(frame)
        size = self._encoder.size_bytes(frame, form)
        if not self._has_room(size, now_s):
            return None
        self._form, self._sent_s = form, now_s
        return form

    def _fitting(self, frame: LiveFrame) -> PictureForm:
        rates, present = self._link.rates, FORMS.index(self._form)
        for index, form in enumerate(FORMS[:-1]):
            size = self._encoder.size_bytes(frame, form)
            if rates is None:
                fits = size <= FIRST_BYTES
            else:
                room = ROOM if index < present else 1.0
                fits = room * size <= SHARE * rates.possibly * form.period_s
                fits &= size <= max(SURELY_S * rates.surely, GROWTH * rates.largest_bytes)
            if fits:
                return form
        return FORMS[-1]

    def _has_room(self, size: float, now_s: float) -> bool:
        link, rates = self._link, self._link.rates
        if rates is None:
            return link.under_way == 0
        rate = rates.probably
        if now_s - self._sent_s < size / (SHARE * rate):
            return False
        most_bytes = rate * (link.round_trip_s + QUEUE_S)
        most = AT_ONCE + link.round_trip_s / PERIOD_S  # a page may be slower than its link
        return link.under_way == 0 or (
            link.under_way < most and link.under_way_bytes + size <= most_bytes
        )
