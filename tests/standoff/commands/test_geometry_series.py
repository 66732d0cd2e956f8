"""``standoff geometry`` on few captures: what is left open, left out or rests on the bench."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from acquisition.bench import BenchConfig
from acquisition.plan import parse_plan
from acquisition.session._record import Photograph
from acquisition.session._writer import SessionWriter
from calibration.geometry import GeometryCapture
from tests.acquisition.session_fixtures import bench_of
from tests.calibration.geometry_bench import captures
from tests.standoff.conftest import Command

pytestmark = pytest.mark.slow
TWO_HEIGHTS_MM = (180.0, 220.0)


def imported(
    path: Path, series: Sequence[GeometryCapture], bench: BenchConfig | None = None
) -> Path:
    """A session of photographs, with as much of a bench file as is given."""
    plan = parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "series",
            "targets": [
                {
                    "kind": one.kind,
                    "target": one.target,
                    "orientations_deg": [one.orientation_deg],
                    "heights_mm": [one.height_mm for one in series],
                }
                for one in series[:1]
            ],
        },
        source="test",
    )
    with SessionWriter(path, plan=plan, bench=bench, devices={}, operator="Ada") as session:
        for entry, one in zip(session.pending_entries(), series, strict=True):
            assert entry.height_mm == one.height_mm
            session.add_photograph(
                entry,
                Photograph(
                    image_dn=one.image.astype(np.float32),
                    pixel_format="Mono12",
                    max_level_dn=4095.0,
                ),
            )
    return path


def test_photographs_of_no_known_length_give_the_pupil_and_say_what_is_open(
    command: Command, tmp_path: Path
) -> None:
    session = imported(tmp_path / "s", captures("coins", TWO_HEIGHTS_MM))
    done = command.done("geometry", "--session", session, "--out", tmp_path / "g.json")
    assert "only two heights: nothing checks them" in done.err
    assert "--board names another" not in done.err  # no board was seen
    focal = next(line for line in done.out.splitlines() if "focal length / px" in line)
    assert "not determined" in focal
    assert "focal_length_px is not determined: no length is known" in done.out
    assert "Heights (scale by" not in done.out
    assert done.out.endswith(f"wrote {tmp_path / 'g.json'}\n")


def test_without_a_board_the_scale_rests_on_the_bench_file_or_on_what_is_given(
    command: Command, tmp_path: Path
) -> None:
    session = imported(tmp_path / "s", captures("coins", TWO_HEIGHTS_MM), bench_of())
    words = ("geometry", "--session", session, "--out", tmp_path / "g.json")
    by_bench = command.done(*words)
    assert "(scale by the focal length and pixel pitch of the bench file" in by_bench.out
    given = command.done(*words, "--scale", 2.5, "--force")
    assert "Heights (scale by the scale that was given)" in given.out
    row = next(line for line in given.out.splitlines() if line.startswith("│ 180 "))
    assert row.split("│")[2].strip() == "2.50000"  # at the lowest height, as it was given


def test_a_photograph_of_something_else_is_named_and_left_out(
    command: Command, tmp_path: Path
) -> None:
    series = captures("coins", (*TWO_HEIGHTS_MM, 275.0))
    [other] = captures("brick", (275.0,))
    session = imported(tmp_path / "s", [*series[:2], other])
    done = command.done("geometry", "--session", session, "--out", tmp_path / "g.json")
    [line] = [line for line in done.err.splitlines() if "is left out" in line]
    assert "captures/0002_" in line
