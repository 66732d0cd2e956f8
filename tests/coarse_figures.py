"""Figures for tests that look at none."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from analysis.reports import _page as page


@contextmanager
def coarse_figures() -> Iterator[None]:
    """Draw figures with few pixels and not laid out."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(page, "_PNG_DPI", 40)
        patched.setattr(page, "_lay_out", lambda figure: figure.set_layout_engine(None))
        yield
