"""``standoff paper``: the paper's experiment on the simulated bench."""

from pathlib import Path
from statistics import median
from typing import Annotated

from typer import Option

from standoff import library, terminal
from standoff.shipped_configs import shipped_config


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
    from acquisition.session import MANIFEST_NAME

    if not (out / "session" / MANIFEST_NAME).is_file():  # else it is resumed
        terminal.refuse_overwriting([out / name for name in library.VALIDATION_FILES], force=force)
    config = terminal.read_bench(shipped_config("paper_bench.toml"), settings)
    result = library.run_paper(
        out,
        config,
        models=None if models is None else terminal.chosen_models(models),
        workers=workers,
        is_short=short,
        progress=terminal.ShownProgress(),
    )
    if json:
        terminal.print_json(result.to_json())
        return
    errors_px = result.registration_errors_px
    terminal.print_validation(result.validation)
    terminal.say(
        "alignment against the bench's truth: median error "
        f"{median(errors_px):.4f} px, largest median of a pair {max(errors_px):.4f} px",
        f"wrote {out / 'report.html'} and the tables and figures beside it",
    )
