"""``standoff paper``: the paper's experiment on the simulated bench."""

from pathlib import Path
from statistics import median
from typing import Annotated

import typer

from analysis.choices import PAPER_TRAINING_STEPS
from standoff.shipped_configs import shipped_config
from standoff.terminal import (
    BenchKeys,
    Force,
    Json,
    ShownProgress,
    chosen_models,
    print_json,
    read_bench,
    refuse_overwriting,
    say,
)

_SHORT_STEPS = 25


def paper(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("paper-output"),
    short: Annotated[
        bool,
        typer.Option(
            "--short", help="Quick trial of about a minute, with few pixels, heights and steps."
        ),
    ] = False,
    models: Annotated[
        str | None,
        typer.Option(metavar="M,M", help="As for validate; all but gaussian-kernelgan by default."),
    ] = None,
    workers: Annotated[
        int, typer.Option(min=1, max=1024, help="Worker processes that train kernels.")
    ] = 2,
    settings: BenchKeys = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Repeat the paper's experiment on the simulated bench: Tables I and II, Figures 2 and 3."""
    from acquisition.plan import load_plan
    from acquisition.session import MANIFEST_NAME
    from analysis.validation import KernelBook, ValidationSettings
    from calibration.documents import json_object
    from standoff.library import VALIDATION_FILES, Call, default_models, run_paper, short_bench
    from standoff.terminal import print_validation

    if not (out / "session" / MANIFEST_NAME).is_file():  # else it is resumed
        refuse_overwriting([out / name for name in VALIDATION_FILES], force=force)
    config = read_bench(shipped_config("paper_bench.toml"), settings)
    plan = "paper_validation_short.toml" if short else "paper_validation.toml"
    call = Call("run_paper", ShownProgress())
    chosen = default_models(call) if models is None else chosen_models(models)
    result = run_paper(
        call,
        out,
        short_bench(config) if short else config,
        load_plan(shipped_config(plan)),
        ValidationSettings(
            models=chosen,
            kernels=KernelBook(
                folder=out / "kernels", steps=_SHORT_STEPS if short else PAPER_TRAINING_STEPS
            ),
            workers=1 if short else workers,
        ),
    )
    errors_px = result.registration_errors_px
    if json:
        print_json({**json_object(result.validation), "registration_errors_px": list(errors_px)})
        return
    print_validation(result.validation)
    say(
        "alignment against the bench's truth: median error "
        f"{median(errors_px):.4f} px, largest median of a pair {max(errors_px):.4f} px"
    )
    say(f"wrote {out / 'report.html'} and the tables and figures beside it")
