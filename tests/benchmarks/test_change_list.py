"""Frames of the study of lists whose highlights are cut off, of a scene that is nearly white."""

import numpy as np
import pytest

from analysis.changes import ChangeOptions
from benchmarks.studies.change_list import clipped_pair


@pytest.mark.parametrize("number", [6, 66])
def test_where_nothing_changed_cut_off_highlights_make_no_pixel_false(number: int) -> None:
    # Noise is at white in one photograph or the other all over the frame; 8 and 15 pixels were.
    pair = clipped_pair(number, 0.03)
    found = pair.found(ChangeOptions(pose=pair.pose))
    assert found.summary.changed_px == 0
    assert np.mean(found.valid) > 0.4
