"""What is begun anew when its stream breaks off, as long as a lost camera is waited for."""

from collections.abc import Callable
from typing import TypeVar

from acquisition.errors import StreamInterruptedError

T = TypeVar("T")

RESTARTS_PER_S = 2.0
"""A stream breaks off after a second at the least: more restarts than this are no stalls."""


def restarted(
    work: Callable[[], T],
    *,
    timeout_s: float,
    clock: Callable[[], float],
    interrupted: Callable[[StreamInterruptedError], None] = lambda _: None,
) -> T:
    """Do some work, from its beginning again each time its stream breaks off.

    A busy computer, or a network that is full for a moment, breaks a stream off for a second at a
    time and more than once: that ends nothing. The start of a stream reopens a camera.

    Parameters
    ----------
    work
        Streams from a start of its own; what it had until an interruption is dropped.
    timeout_s
        Time after the first interruption in which another one begins the work anew once more; it
        is begun anew once in any case.
    clock
        Monotonic time in seconds.
    interrupted
        Called with each interruption before the work begins anew.

    Raises
    ------
    StreamInterruptedError
        If the stream broke off again after that time, or too often.
    """
    first_s: float | None = None
    restarts = 0
    while True:
        try:
            return work()
        except StreamInterruptedError as error:
            now_s = clock()
            first_s = now_s if first_s is None else first_s
            is_late = now_s - first_s > timeout_s or restarts > RESTARTS_PER_S * timeout_s
            if restarts > 0 and is_late:
                raise
            restarts += 1
            interrupted(error)
