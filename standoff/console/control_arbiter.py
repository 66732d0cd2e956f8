"""Who is in control: one page at a time, while the others watch; it is asked for and granted."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

AWAY_S = 3.0
"""A page that is not connected for this long is dead, and its control free. The server takes up to
7 s to notice one that ends without a word: 10 s in all."""

UNANSWERED_S = 30.0
"""After this time a request may be taken as granted: somebody left a page open and went home."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlView:
    """Control as one page sees it.

    ``holder`` is a name, empty if nobody is in control; ``is_away`` says that the holder's page
    is not connected at the moment. ``asked_by`` is who asks this page for control, if anybody
    does; ``is_asking`` says that this page does, and ``may_take`` that it need not ask any more.
    """

    is_mine: bool
    holder: str
    is_away: bool
    viewers: int
    asked_by: str = ""
    is_asking: bool = False
    may_take: bool = False


class ControlArbiter:
    """Knows who is connected, who is in control, and who asks for it."""

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = Lock()
        self._present: dict[str, str] = {}
        self._holder: str | None = None
        self._holder_name = ""
        self._left_s = 0.0
        self._asker: str | None = None
        self._asked_s = 0.0

    def join(self, viewer: str, name: str) -> None:
        """Connect a page; it gets control if nobody has it."""
        with self._lock:
            self._free_if_dead()
            self._present[viewer] = name
            if self._holder is None:
                self._hold(viewer)

    def leave(self, viewer: str) -> None:
        """Disconnect a page; it keeps its control for a few seconds, in which it may come back."""
        with self._lock:
            self._present.pop(viewer, None)
            if viewer == self._holder:
                self._left_s = self._clock()
            if viewer == self._asker:
                self._asker = None

    def take(self, viewer: str) -> bool:
        """Take control if it is free, else ask for it; whether the page has it now."""
        with self._lock:
            self._free_if_dead()
            if viewer not in self._present:
                return False
            if self._holder in (None, viewer) or self._is_unanswered(viewer):
                self._hold(viewer)
            elif self._asker is None:
                self._asker, self._asked_s = viewer, self._clock()
            return self._holder == viewer

    def grant(self, viewer: str) -> None:
        """Hand control to who asks for it."""
        with self._lock:
            if viewer == self._holder and self._asker in self._present:
                self._hold(self._asker)

    def refuse(self, viewer: str) -> None:
        """Keep control; or, of who asks, ask no more."""
        with self._lock:
            if viewer in (self._holder, self._asker):
                self._asker = None

    def release(self, viewer: str) -> None:
        """Give up control: to who asks for it, else nobody has it."""
        with self._lock:
            if self._holder != viewer:
                return
            if self._asker in self._present:
                self._hold(self._asker)
            else:
                self._holder, self._holder_name = None, ""

    def is_holder(self, viewer: str) -> bool:
        """Whether this page is in control."""
        return self._holder == viewer

    def operator(self) -> str:
        """Name of whoever is in control; empty if nobody is."""
        with self._lock:
            self._free_if_dead()
            return self._holder_name

    def view(self, viewer: str) -> ControlView:
        """Control as a page sees it."""
        with self._lock:
            self._free_if_dead()
            is_mine = self._holder == viewer
            asker = "" if self._asker is None else self._present.get(self._asker, "")
            return ControlView(
                is_mine=is_mine,
                holder=self._holder_name,
                is_away=self._holder is not None and self._holder not in self._present,
                viewers=len(self._present),
                asked_by=asker if is_mine else "",
                is_asking=self._asker == viewer,
                may_take=not is_mine and (self._holder is None or self._is_unanswered(viewer)),
            )

    def _is_unanswered(self, viewer: str) -> bool:
        return self._asker == viewer and self._clock() - self._asked_s >= UNANSWERED_S

    def _free_if_dead(self) -> None:
        is_away = self._holder is not None and self._holder not in self._present
        if is_away and self._clock() - self._left_s >= AWAY_S:
            self._holder, self._holder_name = None, ""
            if self._asker in self._present:
                self._hold(self._asker)

    def _hold(self, viewer: str | None) -> None:
        assert viewer is not None
        self._holder, self._holder_name = viewer, self._present[viewer]
        self._asker = None
