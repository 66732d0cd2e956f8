"""``standoff benchmark make``: render the public benchmark's data set."""

from pathlib import Path
from typing import Annotated

from typer import Option

from standoff import library, terminal


def make(
    *,
    out: Annotated[Path, Option(help="Folder for the set; one that was begun is resumed.")],
    size: Annotated[
        library.BenchmarkSize,
        Option(help="tiny: a few MB; small: about 100 MB; full: about 1.5 GB."),
    ] = "small",
    seed: Annotated[
        int, Option(min=0, help="Of everything random; published results are for seed 1.")
    ] = 1,
    workers: terminal.Workers = 1,
    json: terminal.Json = False,
) -> None:
    """Render the benchmark's photographs, tasks and truth."""
    made = library.make_benchmark(
        out, size=size, seed=seed, workers=workers, progress=terminal.ShownProgress()
    )
    if json:
        terminal.print_json(made.to_json())
        return
    tasks = ", ".join(f"{count} {track}" for track, count in made.tasks.items())
    terminal.say(
        f"{out}: {made.size} set, seed {made.seed}: tasks {tasks}; {made.files} files, "
        f"{made.bytes / 1e6:.1f} MB ({made.tasks_found_done} tasks already done)",
        f"sha256 {made.sha256}",
    )
