"""``standoff changes``: differences of two photographs that their poses do not explain."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from analysis.changes import FALSE_ALARMS, ChangeOptions, find_changes
from analysis.errors import AnalysisError
from analysis.reports import plot_changes, png_bytes
from analysis.results_file import write_results
from calibration.documents import json_object
from calibration.errors import CalibrationError
from calibration.files import read_noise
from standoff.commands.simulate import read_total_psf
from standoff.terminal import Json, print_json, say
from standoff.workflows import make_folder, read_grey, write_file, write_float_tiff, write_mask

__all__ = ["changes"]


def changes(
    reference: Annotated[Path, typer.Argument(help="The earlier, nearer image.")],
    followup: Annotated[Path, typer.Argument(help="The later image.")],
    *,
    psf: Annotated[Path, typer.Option(help="psf.json of the camera.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    noise: Annotated[
        Path | None, typer.Option(help="noise.json of both captures; else it is fitted.")
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(min=1e-6, max=1e4, help="Pixels flagged by chance, a frame.")
    ] = FALSE_ALARMS,
    json: Json = False,
) -> None:
    """Find what changed between two photographs beyond what the change of pose makes."""
    camera = read_total_psf(psf)
    captures = None if noise is None else read_noise(noise).capture_noise
    near, far = read_grey(reference), read_grey(followup)
    options = ChangeOptions(noise=captures, false_alarms=false_alarms)
    try:
        found = find_changes(near, far, camera, options)
    except CalibrationError as error:
        raise CalibrationError(f"{followup}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{followup}: {error}") from error
    make_folder(out)
    for name, image in (
        ("difference", found.difference_dn),
        ("plain-difference", found.plain_difference_dn),
        ("pose-difference", found.pose_difference_dn),
        ("uncertainty", np.where(found.valid, np.sqrt(found.variance_dn2), 0.0)),
        ("significance", found.significance),
    ):
        description = f"standoff changes: {name} of {followup.name}"
        write_float_tiff(out / f"{name}.tif", image.astype(np.float32), description)
    write_mask(out / "changes.png", found.is_change)
    write_mask(out / "compared.png", found.valid)
    write_file(out / "changes-figure.png", png_bytes(plot_changes(found)))
    summary = found.summary.model_copy(
        update={"reference": str(reference), "followup": str(followup)}
    )
    write_results(out / "changes.json", summary)
    if json:
        print_json({"out": str(out), **json_object(summary)})
        return
    say(
        f"{summary.changed_px} of {summary.compared_px} pixels changed, beyond "
        f"{summary.threshold_sd:.2f} standard deviations (zoom {summary.zoom:.3f}); wrote {out}"
    )
