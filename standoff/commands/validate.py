"""``standoff validate``: simulated against captured follow-ups, as in Tables I and II."""

from pathlib import Path
from typing import Annotated

import typer

from analysis.choices import CACHE_VARIABLE, PAPER_TRAINING_STEPS, VALIDATION_MODELS
from standoff.terminal import (
    Force,
    Json,
    ShownProgress,
    TransferForm,
    chosen_models,
    print_json,
    refuse_overwriting,
    say,
)


def validate(
    *,
    session: Annotated[Path, typer.Option(help="Capture session with textures or charts.")],
    psf: Annotated[
        Path, typer.Option(help="psf.json of the camera, best calibrated with --region centre.")
    ],
    transfer: TransferForm = "best",
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    models: Annotated[
        str | None,
        typer.Option(
            metavar="M,M",
            help=f"Models: any of {', '.join(VALIDATION_MODELS)}; "
            "all but gaussian-kernelgan by default.",
        ),
    ] = None,
    references: Annotated[
        int, typer.Option(min=1, max=100, help="Reference poses per target, the nearest first.")
    ] = 2,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1, help=f"Training steps; {PAPER_TRAINING_STEPS} by default, as in the paper."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed for training.")] = 0,
    workers: Annotated[
        int, typer.Option(min=1, max=1024, help="Worker processes that train kernels.")
    ] = 1,
    kernel_cache: Annotated[
        Path | None,
        typer.Option(
            help=f"Folder of trained kernels; ${CACHE_VARIABLE} or the XDG cache by default."
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure how well each model predicts the captured follow-ups of a session."""
    from analysis.validation import is_learned
    from calibration.documents import json_object
    from standoff.library import VALIDATION_FILES, validate as validated
    from standoff.terminal import print_validation

    chosen = None if models is None else chosen_models(models)
    if chosen is not None and not any(map(is_learned, chosen)) and (steps or seed or kernel_cache):
        raise typer.BadParameter("--steps, --seed and --kernel-cache need a learned model")
    refuse_overwriting([out / name for name in VALIDATION_FILES], [psf], force=force)
    validation = validated(
        session,
        psf,
        out,
        models=chosen,
        transfer=transfer,
        references=references,
        steps=steps or PAPER_TRAINING_STEPS,
        seed=seed,
        workers=workers,
        kernel_cache=kernel_cache,
        progress=ShownProgress(),
    )
    if json:
        print_json(json_object(validation))
        return
    print_validation(validation)
    say(f"wrote {out / 'report.html'} and the tables and figures beside it")
