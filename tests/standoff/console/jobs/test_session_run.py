"""With which exposure and gain a session goes on."""

import json
from pathlib import Path

import pytest

from acquisition.errors import SessionError
from acquisition.session import MANIFEST_NAME
from standoff.console.jobs.session_run import session_bench
from tests.acquisition.fakes import ScriptedCamera
from tests.acquisition.session_fixtures import bench_of, whole_session


def begun_with(path: Path, **camera: object) -> None:
    whole_session(path)
    document = json.loads((path / MANIFEST_NAME).read_text())
    document["bench"]["camera"] |= camera
    (path / MANIFEST_NAME).write_text(json.dumps(document))


def test_a_new_session_runs_with_what_the_camera_has_now(tmp_path: Path) -> None:
    camera = ScriptedCamera()
    bench = session_bench(tmp_path / "new", bench_of(exposure_us=77.0), camera)
    assert bench.camera.exposure_us == camera.settings.exposure_us != 77.0
    assert bench.camera.gain_db == camera.settings.gain_db


def test_a_begun_session_goes_on_with_its_own(tmp_path: Path) -> None:
    begun_with(tmp_path, exposure_us=1234.0, gain_db=3.0)
    bench = session_bench(tmp_path, bench_of(exposure_us=77.0), ScriptedCamera())
    assert (bench.camera.exposure_us, bench.camera.gain_db) == (1234.0, 3.0)


@pytest.mark.parametrize("odd", [[], {}, None, "long", -1.0])
@pytest.mark.parametrize("key", ["exposure_us", "gain_db"])
def test_a_begun_session_without_numbers_is_damaged(tmp_path: Path, key: str, odd: object) -> None:
    begun_with(tmp_path, **{key: odd})
    with pytest.raises(SessionError, match=f"session.json: bench.camera.{key}: .*restore it"):
        session_bench(tmp_path, bench_of(), ScriptedCamera())
