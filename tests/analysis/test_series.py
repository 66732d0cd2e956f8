import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.session.reader import Session
from acquisition.session.take import Take
from analysis.errors import AnalysisError, ResultsFileError
from analysis.series import (
    SeriesComparison,
    compare_series,
    series_of,
    write_comparison,
)
from tests.acquisition.fakes import SETTINGS, FakeUtc
from tests.acquisition.session_fixtures import plan_of, whole_session, writer
from tests.analysis.bench_session import HEIGHTS_MM, PSF, texture_dn
from tests.calibration.edge_session import averaged


def test_a_series_runs_from_the_nearest_to_the_furthest(session: Session) -> None:
    [series] = series_of(session)
    assert [record.height_asked_mm for record in series] == list(HEIGHTS_MM)
    assert {record.kind for record in series} == {"texture"}


def test_a_target_at_one_height_is_no_series(tmp_path: Path) -> None:
    plan = plan_of(heights_mm=[100.0], targets=[{"kind": "texture", "target": "leaves"}])
    now = FakeUtc()
    with writer(tmp_path / "s", plan=plan) as open_session:
        open_session.add_capture(
            open_session.entries[0],
            Take(
                averaged=averaged(texture_dn(1.0), np.random.default_rng(1)),
                settings=SETTINGS,
                height_mm=100.0,
                focus_value=None,
                started=now(),
                finished=now(),
            ),
        )
    session = Session(tmp_path / "s")
    assert series_of(session) == []
    with pytest.raises(AnalysisError, match="no target of kind texture or chart"):
        compare_series(session, PSF)


def test_edges_and_flats_are_not_compared(tmp_path: Path) -> None:
    whole_session(tmp_path / "s")
    assert series_of(Session(tmp_path / "s")) == []


def test_every_height_is_compared_with_the_nearest(comparison: SeriesComparison) -> None:
    assert [pair.reference.height_asked_mm for pair in comparison.pairs] == [100.0, 100.0]
    assert [pair.followup.height_asked_mm for pair in comparison.pairs] == [150.0, 200.0]
    zooms = [pair.comparison.registration.zoom for pair in comparison.pairs]
    assert zooms == pytest.approx([1.5, 2.0], rel=2e-4)


def test_the_means_are_those_of_the_pairs(comparison: SeriesComparison) -> None:
    for model, mean in comparison.means.items():
        errors = [pair.comparison.metrics[model].mse_dn2 for pair in comparison.pairs]
        assert mean.mse_dn2 == pytest.approx(np.mean(errors))
        assert mean.pairs == 2
    means = comparison.means
    assert means["matched"].mse_dn2 < means["paper"].mse_dn2 < means["bicubic"].mse_dn2


def test_progress_counts_the_pairs(session: Session) -> None:
    seen: list[int] = []
    compare_series(session, PSF, seen.append)
    assert seen == [1, 2]


def chart_session(path: Path, *seeds: int) -> Session:
    """Captures of a chart, one height further away each; another seed is another chart."""
    heights = [100.0 * 1.25**k for k in range(len(seeds))]
    plan = plan_of(heights_mm=heights, targets=[{"kind": "chart", "target": "mixed"}])
    now, rng = FakeUtc(), np.random.default_rng(1)
    with writer(path, plan=plan) as open_session:
        for entry, seed in zip(open_session.entries, seeds, strict=True):
            open_session.add_capture(
                entry,
                Take(
                    averaged=averaged(texture_dn(entry.height_mm / 100.0, seed), rng),
                    settings=SETTINGS,
                    height_mm=entry.height_mm,
                    focus_value=None,
                    started=now(),
                    finished=now(),
                ),
            )
    return Session(path)


@pytest.mark.slow
def test_captures_that_do_not_show_one_target_are_named(tmp_path: Path) -> None:
    session = chart_session(tmp_path / "s", 3, 77)
    first, second = (record.file for record in session.records)
    with pytest.raises(AnalysisError, match=f"{first} and {second}: the captures cannot be"):
        compare_series(session, PSF)


@pytest.mark.slow
def test_one_pair_that_cannot_be_aligned_is_left_out_and_said(tmp_path: Path) -> None:
    session = chart_session(tmp_path / "s", 3, 3, 77)
    compared = compare_series(session, PSF)
    assert len(compared.pairs) == 1
    [reason] = compared.left_out
    assert session.records[2].file in reason
    write_comparison(tmp_path / "c.json", compared)
    assert json.loads((tmp_path / "c.json").read_text())["left_out"] == [reason]


class TestComparisonFile:
    def test_it_holds_the_means_and_every_pair(
        self, tmp_path: Path, comparison: SeriesComparison
    ) -> None:
        path = tmp_path / "comparison.json"
        write_comparison(path, comparison)
        document: dict[str, Any] = json.loads(path.read_text())
        assert document["schema"] == "standoff.comparison/1"
        matched = document["table_2"]["matched"]
        assert matched["mse_dn2"] == comparison.means["matched"].mse_dn2
        assert matched["psnr_of_mean_db"] == comparison.means["matched"].psnr_of_mean_db
        first, second = document["pairs"]
        assert (first["target"], first["followup_height_mm"]) == ("leaves", 150.002)
        assert second["zoom"] == comparison.pairs[1].comparison.registration.zoom
        assert set(second["models"]) == {"bicubic", "paper", "matched", "lmmse"}

    def test_a_folder_that_is_not_there_is_named(
        self, tmp_path: Path, comparison: SeriesComparison
    ) -> None:
        with pytest.raises(ResultsFileError, match=r"cannot write .*c\.json: No such file"):
            write_comparison(tmp_path / "nowhere" / "c.json", comparison)
