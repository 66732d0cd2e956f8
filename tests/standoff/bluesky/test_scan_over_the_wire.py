"""A RunEngine scans heights over the real protocols, GigE Vision and Grbl, with the mock."""

from pathlib import Path

import pytest

import standoff
from acquisition.session import verify
from standoff.bluesky import HeightStage, SessionCamera, height_scan
from standoff.library import height_series
from standoff.shipped_configs import shipped_config
from tests.acquisition.aravis_bench import needs_aravis
from tests.hil_mocks.gige_bench import free_addresses
from tests.standoff.console.processes import first_line, standoff_process

HEIGHTS_MM = [310.0, 312.5, 315.0]
SETTINGS = {
    "stage.feed_mm_per_min": 2400.0,
    "stage.settle_s": 0.1,
    "capture.frames_per_capture": 4,
}
SMALL_SENSOR = ("simulated.width_px=240", "simulated.height_px=180")
"""A view of it is rendered before a camera that sends nothing counts as lost, on any machine."""


@needs_aravis
@pytest.mark.waits
@pytest.mark.slow(minutes=0.4)
def test_a_scan_over_the_wire_writes_a_session(tmp_path: Path) -> None:
    run_engine = pytest.importorskip("bluesky.run_engine", reason="needs standoff[bluesky]")
    address, out = next(free_addresses()), tmp_path / "session"
    with standoff_process(
        "mock",
        "--stage-protocol",
        "grbl",
        "--address",
        address,
        "--target",
        "coins",
        *(f"--set={setting}" for setting in SMALL_SENSOR),
        "--json",
        cwd=tmp_path,
    ) as mock:
        served = first_line(mock)
        settings = SETTINGS | {
            "camera.address": served["camera_address"],
            "stage.port": served["stage_port"],
        }
        with standoff.Bench(shipped_config("grbl_stage.toml"), settings=settings) as bench:
            bench.home()
            plan = height_series("scan", HEIGHTS_MM, {"kind": "texture", "target": "coins"})
            camera = SessionCamera(bench, plan, out)
            run_engine.RunEngine(context_managers=[])(height_scan(HeightStage(bench), camera))
    session = standoff.Session(out)
    assert session.is_complete
    assert verify(out).is_ok
    assert session.devices["camera"]["driver"] == "aravis"
    assert session.devices["stage"]["driver"] == "grbl"
    assert [record.height_asked_mm for record in session.records] == HEIGHTS_MM
    assert [record.frames_used for record in session.records] == [4, 4, 4]
    means = [session.load(record).mean_dn for record in session.records]
    # Coins at three distances: no two pictures are the same scene.
    assert all(abs(means[0] - mean).max() > 100 for mean in means[1:])
