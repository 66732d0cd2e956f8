"""``standoff validate``: simulated against captured follow-ups, as in Tables I and II."""

from pathlib import Path
from typing import Annotated

from typer import BadParameter, Option

from analysis.choices import CACHE_VARIABLE, PAPER_TRAINING_STEPS, VALIDATION_MODELS
from standoff import library, terminal


def validate(
    *,
    session: Annotated[Path, Option(help="Capture session with textures or charts.")],
    psf: Annotated[
        Path, Option(help="psf.json of the camera, best calibrated with --region centre.")
    ],
    transfer: terminal.TransferForm = "best",
    out: Annotated[Path, Option(help="Folder for the results.")],
    models: Annotated[
        str | None,
        Option(
            metavar="M,M",
            help=f"Models: any of {', '.join(VALIDATION_MODELS)}; "
            "all but gaussian-kernelgan by default.",
        ),
    ] = None,
    references: Annotated[
        int, Option(min=1, max=100, help="Reference poses per target, the nearest first.")
    ] = 2,
    steps: Annotated[
        int | None,
        Option(min=1, help=f"Training steps; {PAPER_TRAINING_STEPS} by default, as in the paper."),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Seed for training.")] = 0,
    workers: terminal.KernelWorkers = 1,
    kernel_cache: Annotated[
        Path | None,
        Option(help=f"Folder of trained kernels; ${CACHE_VARIABLE} or the XDG cache by default."),
    ] = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Measure how well each model predicts the captured follow-ups of a session."""
    from analysis.validation import is_learned

    chosen = None if models is None else terminal.chosen_models(models)
    if chosen is not None and not any(map(is_learned, chosen)) and (steps or seed or kernel_cache):
        raise BadParameter("--steps, --seed and --kernel-cache need a learned model")
    results = [out / name for name in library.VALIDATION_FILES]
    terminal.refuse_overwriting(results, [psf], force=force)
    validation = library.validate(
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
        progress=terminal.ShownProgress(),
    )
    if json:
        terminal.print_json(validation)
    else:
        terminal.print_validation(validation)
        terminal.say(f"wrote {out / 'report.html'} and the tables and figures beside it")
