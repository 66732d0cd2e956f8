"""Watches how sharp the picture of a bench's camera is."""

from collections.abc import Callable
from contextlib import closing

from acquisition.focus import FocusOptions, FocusReading, FocusTrace, focus_values
from standoff.library.bench.devices import OpenCamera


def watch_focus(
    opened: OpenCamera,
    options: FocusOptions,
    show: Callable[[FocusReading], None],
    *,
    smoothed: int,
    readings: int | None = None,
) -> FocusReading:
    """Show the focus value until Ctrl-C, or for a number of readings; return the last one.

    Ctrl-C is the normal way to end this, so it is not an error once a value has been shown.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C came before the first value.
    """
    trace = FocusTrace(smoothed=smoothed, window=max(12, smoothed))
    last: FocusReading | None = None
    try:
        with closing(focus_values(opened.camera, options)) as values:
            for count, value in enumerate(values, start=1):
                last = trace.add(value)
                show(last)
                if count == readings:
                    break
    except KeyboardInterrupt:
        if last is None:
            raise
    assert last is not None
    return last
