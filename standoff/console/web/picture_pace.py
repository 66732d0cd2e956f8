"""When the next picture goes to a page, and in which form: as fast as its link carries them."""

from standoff.console.devices import FORMS, LiveFrame, PictureEncoder, PictureForm
from standoff.console.web.link import Link

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
    """Decides for one page.

    Parameters
    ----------
    link
        The page's.
    encoder
        Knows how large pictures are in each form.
    """

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
