"""``standoff validate``: simulated against captured follow-ups, as in Tables I and II."""

from pathlib import Path
from typing import Annotated

import typer

from analysis.choices import CACHE_VARIABLE, PAPER_TRAINING_STEPS, VALIDATION_MODELS
from standoff.terminal import (
    Force,
    Json,
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
    from acquisition.session import Session
    from analysis.validation import (
        KernelBook,
        ValidationSettings,
        default_cache_folder,
        is_learned,
    )
    from calibration.documents import json_object
    from standoff.terminal import print_validation
    from standoff.workflows import (
        VALIDATION_FILES,
        default_models,
        read_camera_psf,
        run_validation,
    )

    chosen = default_models() if models is None else chosen_models(models)
    if not any(map(is_learned, chosen)) and (steps is not None or seed or kernel_cache):
        raise typer.BadParameter("--steps, --seed and --kernel-cache need a learned model")
    refuse_overwriting([out / name for name in VALIDATION_FILES], [psf], force=force)
    camera = read_camera_psf(psf, transfer)
    settings = ValidationSettings(
        models=chosen,
        kernels=KernelBook(
            folder=kernel_cache or default_cache_folder(),
            steps=steps or PAPER_TRAINING_STEPS,
            seed=seed,
        ),
        references=references,
        workers=workers,
    )
    validation = run_validation(out, Session(session), camera, str(psf), settings)
    if json:
        print_json(json_object(validation))
        return
    print_validation(validation)
    say(f"wrote {out / 'report.html'} and the tables and figures beside it")
