"""``standoff changes``: differences of two photographs that their poses do not explain."""

from __future__ import annotations

import json as json_module
import math
from pathlib import Path
from typing import Annotated

import typer

from analysis.choices import FALSE_ALARMS
from standoff.terminal import Json, print_json, say

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
    from calibration.files import read_noise
    from standoff.workflows import (
        find_changes_of_files,
        make_folder,
        read_total_psf,
        write_change_pictures,
        write_file,
    )

    result = find_changes_of_files(
        reference,
        followup,
        read_total_psf(psf),
        None if noise is None else read_noise(noise),
        false_alarms,
    )
    make_folder(out)
    write_change_pictures(out, followup.name, result)
    aligned, found = result.aligned, result.found
    pose = aligned.pose
    document = {
        "schema": "standoff.changes/1",
        "reference": str(reference),
        "followup": str(followup),
        "homography": pose.matrix.tolist(),
        "distortion_k1": pose.k1,
        "distortion_k1_err": aligned.k1_err,
        "zoom": aligned.zoom,
        "changed_px": int(found.is_change.sum()),
        "compared_px": int(found.valid.sum()),
        "threshold_sd": found.threshold,
        "false_alarms_px": false_alarms,
        "gain": found.gain,
        "extra_blur_px2": found.extra_blur_px2,
        "extra_blur_err_px2": (
            found.extra_blur_err_px2 if math.isfinite(found.extra_blur_err_px2) else None
        ),
        "noise_factor": found.uncertainty.noise_factor,
        "is_noise_known": noise is not None,
        "registration_err_px": found.uncertainty.registration_err_px,
        "width_err_px2": found.uncertainty.width_err_px2,
    }
    write_file(out / "changes.json", (json_module.dumps(document, indent=1) + "\n").encode())
    if json:
        print_json({"out": str(out), **document})
        return
    say(
        f"{document['changed_px']} of {document['compared_px']} pixels changed, beyond "
        f"{found.threshold:.2f} standard deviations (zoom {aligned.zoom:.3f}); wrote {out}"
    )
