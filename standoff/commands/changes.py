"""``standoff changes``: differences between two photographs that their poses do not explain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from analysis.choices import FALSE_ALARMS
from standoff.terminal import (
    EncodingName,
    Json,
    Mean,
    Page,
    TransferForm,
    command_line,
    photograph_inputs,
    print_json,
    say,
)


def changes(
    reference: Annotated[Path, typer.Argument(help="The earlier, nearer photograph.")],
    followup: Annotated[Path, typer.Argument(help="The later photograph.")],
    *,
    psf: Annotated[Path, typer.Option(help="psf.json of the camera.")],
    transfer: TransferForm = "best",
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    noise: Annotated[
        Path | None, typer.Option(help="noise.json of the camera; the noise is fitted by default.")
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(min=1e-6, max=1e4, help="Pixels flagged by chance per frame.")
    ] = FALSE_ALARMS,
    encoding: EncodingName = "auto",
    page: Page = None,
    mean: Mean = False,
    json: Json = False,
) -> None:
    """Find what changed between two photographs that their poses do not explain."""
    from acquisition.printable import on_one_line
    from analysis.changes import ChangeOptions
    from analysis.results_file import write_results
    from calibration.documents import json_object
    from calibration.files import read_noise
    from standoff.workflows import (
        find_changes_of_files,
        make_folder,
        write_change_pictures,
    )

    inputs = photograph_inputs(encoding, page, mean, files=(psf, noise))
    options = ChangeOptions(
        noise=None if noise is None else read_noise(noise).capture_noise,
        false_alarms=false_alarms,
    )
    found = find_changes_of_files(reference, followup, psf, options, inputs, transfer)
    make_folder(out)
    write_change_pictures(out, followup.name, found)
    summary = found.summary.model_copy(
        update={
            "reference": on_one_line(reference),
            "followup": on_one_line(followup),
            "provenance": inputs.provenance(command_line()),
        }
    )
    write_results(out / "changes.json", summary)
    if json:
        print_json({"out": str(out), **json_object(summary)})
        return
    say(
        f"{summary.changed_px} of {summary.compared_px} pixels changed by more than "
        f"{summary.threshold_sd:.2f} standard deviations (zoom {summary.zoom:.3f}); wrote {out}"
    )
