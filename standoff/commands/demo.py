"""``standoff demo``: the whole chain on the simulated bench."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulation.choices import MODELS
from standoff.shipped_configs import shipped_config
from standoff.terminal import (
    BenchKeys,
    Force,
    Json,
    ShownProgress,
    print_json,
    print_table,
    read_bench,
    refuse_overwriting,
    say,
)

if TYPE_CHECKING:
    from standoff.library import DemoResult


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("standoff-demo"),
    settings: BenchKeys = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run the whole chain on the simulated bench, and compare the results with its truth."""
    from acquisition.plan import load_plan
    from acquisition.session import MANIFEST_NAME
    from standoff.library import DEMO_FILES, Call, run_demo

    if not (out / "session" / MANIFEST_NAME).is_file():  # else it is resumed
        refuse_overwriting([out / name for name in DEMO_FILES], force=force)
    config = read_bench(shipped_config("demo_bench.toml"), settings)
    result = run_demo(
        Call("run_demo", ShownProgress()), out, config, load_plan(shipped_config("demo_plan.toml"))
    )
    if json:
        print_json(result.document())
        return
    _print_summary(result)


def _print_summary(result: DemoResult) -> None:
    print_table(
        "Calibration against the bench's truth",
        ["", "truth", "measured", "95 % interval", "error", "inside"],
        [
            [
                row.name,
                f"{row.truth:.4f}",
                f"{row.estimate.value:.4f}",
                f"{row.estimate.low:.4f} to {row.estimate.high:.4f}",
                f"{100 * row.error / row.truth:+.2f} %" if row.truth else f"{row.error:+.4f}",
                "yes" if row.is_inside else "no",
            ]
            for row in result.truth
        ],
    )
    means = result.validation.means("followup-grid")
    print_table(
        "Simulated against captured follow-ups, after the paper's processing",
        ["model", "correlation", "MSE", "NMI", "PSNR / dB", "SSIM", "MSE of bicubic / MSE"],
        [
            [
                model,
                f"{means[model].correlation:.4f}",
                f"{means[model].mse_dn2:.2f}",
                f"{means[model].nmi:.3f}",
                f"{means[model].psnr_db:.1f}",
                f"{means[model].ssim:.4f}",
                f"{means['bicubic'].mse_dn2 / means[model].mse_dn2:.1f}",
            ]
            for model in MODELS
        ],
    )
    print_table(
        "Zoom-out between the captures",
        ["", "truth", "measured"],
        [
            [f"pair {number}", f"{true:.5f}", f"{found:.5f}"]
            for number, (true, found) in enumerate(result.zooms, start=1)
        ],
    )
    say(f"report: {result.report}")
