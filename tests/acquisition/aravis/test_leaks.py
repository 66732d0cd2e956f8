"""What a hundred openings leave behind: nothing."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from acquisition.errors import CameraFeatureError
from tests.acquisition.aravis_bench import needs_aravis, opened
from tests.hil_mocks.gige_bench import gige_bench

pytestmark = [needs_aravis, pytest.mark.slow]

CYCLES = 100
KEYS = {"packet_size_bytes": 1500, "pixel_format": "Mono8"}
BUFFERS_BYTES = 18 * 320 * 240
"""What one cycle holds: 0.3 s of frames at 60 Hz."""


@dataclass(frozen=True, kw_only=True)
class Holdings:
    """What this process holds."""

    threads: int
    files: int
    memory_bytes: int


def holdings() -> Holdings:
    status = Path("/proc/self/status").read_text()
    memory_kb = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
    return Holdings(
        threads=len(list(Path("/proc/self/task").iterdir())),
        files=len(list(Path("/proc/self/fd").iterdir())),
        memory_bytes=1024 * int(memory_kb),
    )


def test_a_hundred_openings_leave_no_thread_socket_or_buffer() -> None:
    with gige_bench(simulated__width_px=320, simulated__height_px=240) as bench:

        def cycle() -> None:
            with opened(bench, **KEYS) as camera:
                camera.start()
                assert camera.next_frame(1.0).is_complete

        for _ in range(5):
            cycle()
        before = holdings()
        for _ in range(CYCLES):
            cycle()
        after = holdings()
    assert (after.threads, after.files) == (before.threads, before.files)
    # Lost buffers would be 138 MB; a tenth of that is allocator's noise.
    assert after.memory_bytes - before.memory_bytes < 0.1 * CYCLES * BUFFERS_BYTES


def test_reconnections_and_failed_openings_leave_nothing_either() -> None:
    with gige_bench() as bench:

        def fail() -> None:
            with pytest.raises(CameraFeatureError), opened(bench, **KEYS, gain_db=99.0):
                pass

        with opened(bench, **KEYS) as camera:
            camera.start()
            camera.stop()
            before = holdings()
            for _ in range(10):
                bench.camera.restart()
                camera.start()
                assert camera.next_frame(1.0).is_complete
                camera.stop()
            after = holdings()
            assert (after.threads, after.files) == (before.threads, before.files)
        fail()
        before = holdings()
        for _ in range(20):
            fail()
        after = holdings()
    assert (after.threads, after.files) == (before.threads, before.files)
