"""Bench and plan of a session of board captures by a small camera."""

from tests.standoff.conftest import SMALL_BENCH

BOARD_BENCH = (
    SMALL_BENCH.replace("width_px = 160", "width_px = 320")
    .replace("height_px = 128", "height_px = 240\npupil_offset_mm = 12.5")
    .replace("pixel_pitch_um = 8.3", "pixel_pitch_um = 20.0")
)
BOARD_PLAN = """
schema = "standoff.plan/1"
name = "geometry"
heights_mm = [160.0, 220.0, 300.0]
frames_per_capture = 4

[[targets]]
kind = "board"
target = "board"
orientations_deg = [5.0]
"""
