import time

import numpy as np
import pytest

from acquisition.bracket import ExposureControl
from hil_mocks.gige.settings import GigeFaults
from tests.acquisition.aravis_bench import needs_aravis, opened
from tests.hil_mocks.gige_bench import HEIGHT_MM, gige_bench

EXPOSURES_US = [500.0, 2000.0, 8000.0]
FRAMES = 3


@pytest.mark.slow
@needs_aravis
@pytest.mark.parametrize("delay", [0, 5])
def test_a_bracket_over_the_wire_has_only_frames_of_its_exposures(delay: int) -> None:
    with gige_bench() as bench, opened(bench, exposure_us=4000.0) as camera:
        bench.place("edge", 5.0)
        bench.camera.faults = GigeFaults(exposure_delay_frames=delay)
        control = ExposureControl(camera, 4000.0, time.monotonic)
        for _ in range(2):
            taken = control.bracket(FRAMES, EXPOSURES_US, keep_frames=True)
            for one in taken:
                expected = bench.truth.expected_image_dn(
                    "edge", 5.0, HEIGHT_MM, exposure_us=one.exposure_us
                )
                levels = [float(np.mean(image)) for image in one.raw_frames]
                assert len(levels) == FRAMES
                # The next exposure differs by a factor of 4, noise of 6144 pixels by .3 DN.
                assert levels == pytest.approx([float(expected.mean())] * FRAMES, rel=0.01)
            assert [one.exposure_us for one in taken] == EXPOSURES_US
        assert taken[-1].averaged.stale_frames >= delay - 1
