"""``standoff demo`` and ``standoff paper``: experiments on the simulated bench."""

from __future__ import annotations

import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Annotated

from typer import Option

from simulation.choices import MODELS
from standoff import library, terminal
from standoff.compiled_cache import OF_THE_DEMO, compile_ahead, holds_code
from standoff.shipped_configs import shipped_config


def demo(
    out: Annotated[Path, Option(help="Folder for the results.")] = Path("standoff-demo"),
    settings: terminal.BenchKeys = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Run the whole chain on the simulated bench, and compare the results with its truth."""
    from acquisition.session import MANIFEST_NAME

    if not (out / "session" / MANIFEST_NAME).is_file():  # else it is resumed
        terminal.refuse_overwriting([out / name for name in library.DEMO_FILES], force=force)
    config = terminal.read_bench(shipped_config("demo_bench.toml"), settings)
    if not holds_code():
        terminal.note_in_passing("compiling the numerical code, once: up to a minute")
        compile_ahead(OF_THE_DEMO)
    result = library.run_demo(out, config, progress=terminal.ShownProgress())
    if json:
        terminal.print_json(result.to_json())
    else:
        _print_summary(result, out)


def _print_summary(result: library.DemoResult, out: Path) -> None:
    terminal.print_table(
        "Calibration against the bench's truth",
        ["", "truth", "measured", "95 % interval", "error", "inside"],
        [
            [
                row.name,
                f"{row.truth:.4f}",
                f"{row.estimate.value:.4f}",
                f"{row.estimate.low:.4f} to {row.estimate.high:.4f}",
                f"{row.error:+.4f}"
                if row.relative_error is None
                else f"{100 * row.relative_error:+.2f} %",
                "yes" if row.is_inside else "no",
            ]
            for row in result.truth
        ],
    )
    means = result.validation.means("followup-grid")
    terminal.print_table(
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
    terminal.print_table(
        "Zoom-out between the captures",
        ["", "truth", "measured"],
        [
            [f"pair {number}", f"{true:.5f}", f"{found:.5f}"]
            for number, (true, found) in enumerate(result.zooms, start=1)
        ],
    )
    terminal.say(result.real_pair.sentence, f"report: {result.report}")
    terminal.print_next_steps(_next_steps(out, result))


def _next_steps(out: Path, result: library.DemoResult) -> list[tuple[str, str]]:
    captures = result.session / "captures"
    edges = sorted(captures.glob("*_edge-*_h0180*"))
    scene = sorted(captures.glob("*_texture-*"))[0]
    before, after = (out / name for name in library.DEMO_PHOTOGRAPHS)
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
