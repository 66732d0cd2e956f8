"""Whether what a soak stored is what its scene shows: levels against the scene's own."""

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.session import CaptureImages
from hil_mocks.scene import BenchTruth, CameraPose
from simulation.arrays import FloatArray

TARGET = "brick"
"""Has detail everywhere: at another height every pixel has another level."""

DEVIATION_MAX = 1.02
"""Rms of all pixels over what their noise makes of it. Without a fault it is 1 to 0.2 %; a height
that is wrong by 0.1 mm makes 1.026 of it, an exposure that is wrong by 5 % makes 4."""


class SceneTruth:
    """The scene under the camera of a simulated bench."""

    def __init__(self, config: BenchConfig) -> None:
        self._truth = BenchTruth(config)
        self._expected: dict[tuple[float, float], FloatArray] = {}

    def deviation(self, images: CaptureImages) -> float:
        """Rms of a capture about the scene at its height, in standard deviations of its noise."""
        record = images.record
        exposure_us, gain_db = record.exposure_us or 0.0, record.gain_db or 0.0
        key = record.height_mm, exposure_us
        if key not in self._expected:
            pose = CameraPose(height_mm=record.height_mm)
            light = self._truth.irradiance(TARGET, 0.0, pose)
            self._expected[key] = self._truth.sensor.expected_dn(
                light, exposure_us, gain_db, record.pixel_format
            )
        expected = self._expected[key]
        sensor = self._truth.sensor
        offset_dn2 = sensor.variance_dn2(sensor.black_level_dn, gain_db)
        slope_dn = sensor.variance_dn2(sensor.black_level_dn + 1, gain_db) - offset_dn2
        variance = offset_dn2 + slope_dn * (expected - sensor.black_level_dn)
        square = (images.mean_dn - expected) ** 2 / (variance / record.frames_used)
        return float(np.sqrt(np.mean(square)))
