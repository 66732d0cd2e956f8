from pathlib import Path

import numpy as np
import pytest

from acquisition.bench import load_bench
from acquisition.plan import load_plan
from standoff.library.rehearsal import short_bench
from standoff.shipped_configs import shipped_config
from tests.standoff.conftest import Command


@pytest.mark.slow(minutes=0.5)
def test_the_short_experiment_puts_the_models_in_the_papers_order(
    command: Command, tmp_path: Path
) -> None:
    pytest.importorskip("torch")
    out = tmp_path / "paper"
    document = command.document(
        "paper", "--short", "--out", out, "--models", "bicubic,kernelgan,paper,matched"
    )
    assert document["excluded"] == []
    assert len(document["pairs"]) == 9  # three targets, 2 + 1 pairs each
    for alignment in ("as-in-paper", "reference-grid", "followup-grid"):
        for table, is_less_better in (("table_1", True), ("table_2", False)):
            rows = {row["model"]: row for row in document[table] if row["alignment"] == alignment}
            for metric in ("correlation", "mse_dn2", "nmi", "psnr_db", "ssim"):
                low, high = rows["paper"][metric], rows["bicubic"][metric]
                if not (is_less_better or metric == "mse_dn2"):
                    low, high = high, low
                assert low < high, (table, alignment, metric)
    assert [
        remark for remark in document["remarks"] if "kernelgan was trained in 25 steps" in remark
    ]
    for row in document["table_2"]:
        assert row["training_steps"] == (25 if row["model"] == "kernelgan" else None)
    assert "kernelgan (25 steps)" in (out / "table_2.txt").read_text()
    assert np.median(document["registration_errors_px"]) < 0.05
    assert len(list((out / "kernels").glob("*.npy"))) == 9
    before = {path: path.stat().st_mtime_ns for path in (out / "session").rglob("*.tif")}
    again = command.done("paper", "--short", "--out", out, "--models", "bicubic")
    assert "alignment against the bench's truth" in again.out
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_the_short_bench_sees_the_same_field_with_fewer_pixels() -> None:
    whole = load_bench(shipped_config("paper_bench.toml"))
    small = short_bench(whole)
    assert whole.simulated is not None
    assert small.simulated is not None
    for config in (whole, small):
        assert config.simulated is not None
        field_um = config.simulated.width_px * config.optics.pixel_pitch_um
        assert field_um == pytest.approx(780 * 8.3)
    assert small.simulated.width_px * small.simulated.height_px < 780 * 580 / 8


def test_the_plan_stands_for_the_papers_experiment() -> None:
    plan = load_plan(shipped_config("paper_validation.toml"))
    bench = load_bench(shipped_config("paper_bench.toml"))
    assert plan.frames_per_capture == 10
    assert [t.kind for t in plan.targets] == ["edge", "texture", "texture", "chart"]
    assert plan.heights_mm is not None
    assert len(plan.heights_mm) >= 8
    assert bench.simulated is not None
    assert bench.simulated.corner_sigma_gain > 0
    assert bench.simulated.shadow > 0
    assert bench.simulated.dimming_per_100mm > 0
    assert abs(bench.simulated.k1) == 0.01


def test_a_real_bench_is_refused(command: Command, tmp_path: Path) -> None:
    command.refused(1, "paper", "--out", tmp_path / "p", "--set", 'camera.driver="files"')
