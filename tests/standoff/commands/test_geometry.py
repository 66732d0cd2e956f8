import json
from pathlib import Path

import pytest

from tests.standoff.commands.board_session import BOARD_BENCH, BOARD_PLAN
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance


@pytest.mark.slow
def test_a_board_session_gives_its_geometry_and_a_report(command: Command, tmp_path: Path) -> None:
    session = command.captured(tmp_path, BOARD_BENCH, BOARD_PLAN)
    out, page = tmp_path / "geometry.json", tmp_path / "report.html"
    done = command.done("geometry", "--session", session, "--out", out, "--report", page, "--json")
    document = json.loads(done.out)
    assert document == json.loads(out.read_text())
    assert_provenance(document, "geometry", session / "journal.jsonl")
    assert document["heights_mm"] == [160.0, 220.0, 300.0]
    assert document["pupil_offset_mm"] == pytest.approx(12.5, abs=0.3)
    # 8 mm over 20 um, and the distance from the entrance pupil.
    assert document["scale_px_per_mm"][0] == pytest.approx(400 / 172.5, rel=1e-3)
    assert "--board" in done.err
    text = page.read_text()
    assert document["provenance"]["inputs"][0]["sha256"] in text
    assert "Squareness" in text
    assert 'src="http' not in text

    table = command.done("geometry", "--session", session, "--out", out, "--force")
    low, high = document["pupil_offset_interval_95_mm"]
    [line] = [line for line in table.out.splitlines() if "entrance pupil" in line]
    assert line.split("│")[3].strip() == f"{0.5 * (high - low):.3f}"
    assert "± at 95 %" in table.out

    words = ("geometry", "--session", session, "--out", tmp_path / "g2.json")
    err = command.refused(1, *words, "--board", "5x5:12:9:5X5_50")
    assert err.count("\n") == 1
    assert "corners" in err
    assert "--board" in err


def test_a_session_of_edges_alone_is_refused_in_one_line(
    command: Command, session_dir: Path, tmp_path: Path
) -> None:
    err = command.refused(1, "geometry", "--session", session_dir, "--out", tmp_path / "g.json")
    assert "no capture of kind board, chart, texture" in err
    assert not (tmp_path / "g.json").exists()
