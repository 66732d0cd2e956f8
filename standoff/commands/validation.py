"""``standoff validate``, ``demo`` and ``paper``: what is simulated against what is captured.

A session of one's own, as in Tables I and II; and whole experiments on the simulated bench.
"""

from __future__ import annotations

import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from analysis.choices import CACHE_VARIABLE, PAPER_TRAINING_STEPS, VALIDATION_MODELS
from simulation.choices import MODELS
from standoff import library, terminal
from standoff.compiled_cache import OF_THE_DEMO, compile_ahead, holds_code
from standoff.shipped_configs import shipped_config

if TYPE_CHECKING:
    from analysis.validation import Validation


@terminal.command()
def validate(
    *,
    session: Path,
    psf: Path,
    transfer: terminal.TransferForm = "best",
    out: Path,
    models: Annotated[
        str | None,
        Option(
            metavar="M,M",
            help=f"Models: any of {', '.join(VALIDATION_MODELS)}; "
            "all but gaussian-kernelgan by default.",
        ),
    ] = None,
    references: Annotated[int, Option(min=1, max=100)] = 2,
    steps: Annotated[
        int | None,
        Option(min=1, help=f"Training steps; {PAPER_TRAINING_STEPS} by default, as in the paper."),
    ] = None,
    seed: Annotated[int, Option(min=0)] = 0,
    workers: terminal.KernelWorkers = 1,
    kernel_cache: Annotated[
        Path | None,
        Option(help=f"Folder of trained kernels; ${CACHE_VARIABLE} or the XDG cache by default."),
    ] = None,
    force: terminal.Force = False,
) -> None:
    """Measure how well each model predicts the captured follow-ups of a session.

    Options
    -------
    session: Capture session with textures or charts.
    psf: psf.json of the camera, best calibrated with --region centre.
    out: Folder for the results.
    references: Number of reference poses per target, counted from the nearest.
    seed: Seed for training.
    """
    from analysis.validation import is_learned

    chosen = terminal.chosen_models(models)
    if chosen is not None and not any(map(is_learned, chosen)) and (steps or seed or kernel_cache):
        raise BadParameter("--steps, --seed and --kernel-cache need a learned model")
    terminal.refuse_replacing(*(out / name for name in library.VALIDATION_FILES))
    how = terminal.keywords_of(library.validate, models=chosen, steps=steps or PAPER_TRAINING_STEPS)
    validation = library.validate(session, psf, out, **how)
    terminal.answer(validation, lambda: _show_validation(validation, out))


def _show_validation(validation: Validation, out: Path, *more: str) -> None:
    terminal.print_validation(validation)
    terminal.say(*more, f"wrote {out / 'report.html'} and the tables and figures beside it")


@terminal.command()
def demo(
    out: Annotated[Path, Option()] = Path("standoff-demo"),
    settings: terminal.BenchKeys = None,
    force: terminal.Force = False,
) -> None:
    """Run the whole chain on the simulated bench, and compare the results with its truth.

    Options
    -------
    out: Folder for the results.
    """
    from acquisition.session import MANIFEST_NAME

    if not (out / "session" / MANIFEST_NAME).is_file():  # else it is resumed
        terminal.refuse_replacing(*(out / name for name in library.DEMO_FILES))
    config = terminal.read_bench(shipped_config("demo_bench.toml"), settings)
    if not holds_code():
        terminal.note_in_passing("compiling the numerical code, once: up to a minute")
        compile_ahead(OF_THE_DEMO)
    result = library.run_demo(out, config, progress=terminal.ShownProgress())
    terminal.answer(result.to_json, lambda: _print_summary(result, out))


def _print_summary(result: library.DemoResult, out: Path) -> None:
    terminal.print_items(
        "Calibration against the bench's truth",
        result.truth,
        {
            "": lambda row: row.name,
            "truth": lambda row: f"{row.truth:.4f}",
            "measured": lambda row: f"{row.estimate.value:.4f}",
            "95 % interval": lambda row: f"{row.estimate.low:.4f} to {row.estimate.high:.4f}",
            "error": lambda row: (
                f"{row.error:+.4f}"
                if row.relative_error is None
                else f"{100 * row.relative_error:+.2f} %"
            ),
            "inside": lambda row: "yes" if row.is_inside else "no",
        },
    )
    means = result.validation.means("followup-grid")
    terminal.print_items(
        "Simulated against captured follow-ups, after the paper's processing",
        MODELS,
        {
            "model": str,
            "correlation": lambda model: f"{means[model].correlation:.4f}",
            "MSE": lambda model: f"{means[model].mse_dn2:.2f}",
            "NMI": lambda model: f"{means[model].nmi:.3f}",
            "PSNR / dB": lambda model: f"{means[model].psnr_db:.1f}",
            "SSIM": lambda model: f"{means[model].ssim:.4f}",
            "MSE of bicubic / MSE": lambda model: (
                f"{means['bicubic'].mse_dn2 / means[model].mse_dn2:.1f}"
            ),
        },
    )
    terminal.print_items(
        "Zoom-out between the captures",
        enumerate(result.zooms, start=1),
        {
            "": lambda row: f"pair {row[0]}",
            "truth": lambda row: f"{row[1][0]:.5f}",
            "measured": lambda row: f"{row[1][1]:.5f}",
        },
    )
    terminal.say(result.taken_away.sentence, result.real_pair.sentence, f"report: {result.report}")
    terminal.print_next_steps(_next_steps(out, result))


def _next_steps(out: Path, result: library.DemoResult) -> list[tuple[str, str]]:
    captures = result.session / "captures"
    edges = sorted(captures.glob("*_edge-*_h0180*"))
    scene = sorted(captures.glob("*_texture-*"))[0]
    before, after = (out / name for name in library.LANTERN_PHOTOGRAPHS)
    line = terminal.command_line
    return [
        (
            "what changed between two photographs: put two of your own in their place",
            line("changes", before, after, "--out", out / "changes"),
        ),
        (
            "the PSF of a camera, from photographs of straight edges: put your own in their place",
            line("calibrate", *edges, "--out", out / "psf.json", "--report", out / "psf.html"),
        ),
        (
            "how a scene looks from twice as far away",
            line("simulate", scene, "--psf", result.psf, "--zoom", 2, "--out", out / "far.tif"),
        ),
        (
            "how well a change of 40 DN is still detected from further away, at best",
            line(
                "detectability", scene, "--psf", result.psf, "--zooms", "1,1.5,2,3",
                "--noise", 2, "--contrast", 40, "--signal-sigma", 1, "--out", out / "curves.json",
            ),
        ),
        (
            "a camera and a stage to practise with, on this computer alone, until Ctrl-C",
            line("mock", "--stage-protocol", "grbl"),
        ),
        (
            "the operator console on the simulated bench, a web page, until Ctrl-C",
            _console_line(out),
        ),
    ]  # fmt: skip


def _console_line(out: Path) -> str:
    bench = shipped_config("simulated.toml")
    if bench.is_relative_to(Path.cwd()):
        bench = bench.relative_to(Path.cwd())
    console = terminal.command_line("console", "--bench", bench, "--sessions", out / "sessions")
    if find_spec("starlette") is not None:
        return console
    if Path("Makefile").is_file() and bench == Path("configs/simulated.toml"):
        return f"make setup && {console}"
    return f"{shlex.join([sys.executable, '-m', 'pip'])} install 'standoff[console]' && {console}"


@terminal.command()
def paper(
    *,
    out: Path = Path("paper-output"),
    short: Annotated[bool, Option("--short")] = False,
    models: Annotated[str | None, Option(metavar="M,M")] = None,
    workers: terminal.KernelWorkers = 2,
    settings: terminal.BenchKeys = None,
    force: terminal.Force = False,
) -> None:
    """Repeat the paper's experiment on the simulated bench: Tables I and II, Figures 2 and 3.

    Options
    -------
    out: Folder for the results.
    short: Quick trial of about a minute, with few pixels, heights and steps.
    models: As for validate; all but gaussian-kernelgan by default.
    """
    from acquisition.session import MANIFEST_NAME

    if not (out / "session" / MANIFEST_NAME).is_file():  # else it is resumed
        terminal.refuse_replacing(*(out / name for name in library.VALIDATION_FILES))
    config = terminal.read_bench(shipped_config("paper_bench.toml"), settings)
    result = library.run_paper(
        out,
        config,
        models=terminal.chosen_models(models),
        workers=workers,
        is_short=short,
        progress=terminal.ShownProgress(),
    )
    errors_px = result.registration_errors_px
    aligned = (
        "alignment against the bench's truth: median error "
        f"{median(errors_px):.4f} px, largest median of a pair {max(errors_px):.4f} px"
    )
    terminal.answer(result.to_json, lambda: _show_validation(result.validation, out, aligned))
