"""``standoff paper``: the paper's experiment on the simulated bench."""

from pathlib import Path
from statistics import median
from typing import Annotated

from typer import Option

from analysis.choices import PAPER_TRAINING_STEPS
from standoff import library, terminal
from standoff.shipped_configs import shipped_config

_SHORT_STEPS = 25


def paper(
    *,
    out: Annotated[Path, Option(help="Folder for the results.")] = Path("paper-output"),
    short: Annotated[
        bool,
        Option(
            "--short", help="Quick trial of about a minute, with few pixels, heights and steps."
        ),
    ] = False,
    models: Annotated[
        str | None,
        Option(metavar="M,M", help="As for validate; all but gaussian-kernelgan by default."),
    ] = None,
    workers: terminal.KernelWorkers = 2,
    settings: terminal.BenchKeys = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Repeat the paper's experiment on the simulated bench: Tables I and II, Figures 2 and 3."""
    from acquisition.plan import load_plan
    from acquisition.session import MANIFEST_NAME
    from analysis.validation import KernelBook, ValidationSettings
    from calibration.documents import json_object

    if not (out / "session" / MANIFEST_NAME).is_file():  # else it is resumed
        terminal.refuse_overwriting([out / name for name in library.VALIDATION_FILES], force=force)
    config = terminal.read_bench(shipped_config("paper_bench.toml"), settings)
    plan = "paper_validation_short.toml" if short else "paper_validation.toml"
    steps = _SHORT_STEPS if short else PAPER_TRAINING_STEPS
    call = library.Call("run_paper", terminal.ShownProgress())
    chosen = library.default_models(call) if models is None else terminal.chosen_models(models)
    result = library.run_paper(
        call,
        out,
        library.short_bench(config) if short else config,
        load_plan(shipped_config(plan)),
        ValidationSettings(
            models=chosen,
            kernels=KernelBook(folder=out / "kernels", steps=steps),
            workers=1 if short else workers,
        ),
    )
    errors_px = result.registration_errors_px
    if json:
        document = json_object(result.validation)
        terminal.print_json({**document, "registration_errors_px": list(errors_px)})
        return
    terminal.print_validation(result.validation)
    terminal.say(
        "alignment against the bench's truth: median error "
        f"{median(errors_px):.4f} px, largest median of a pair {max(errors_px):.4f} px",
        f"wrote {out / 'report.html'} and the tables and figures beside it",
    )
