"""``standoff changes``: differences of two photographs that their poses do not explain."""

import json as json_module
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from analysis.changes import FALSE_ALARMS, find_changes
from analysis.errors import AnalysisError
from analysis.reports import plot_changes, png_bytes
from calibration.errors import CalibrationError
from calibration.files import read_noise
from calibration.registration import register_distorted
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
    try:
        aligned = register_distorted(near, far, camera)
        pose = aligned.pose
        found = find_changes(
            near,
            far,
            pose.matrix,
            camera,
            captures,
            distortion_k1=pose.k1,
            false_alarms=false_alarms,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{followup}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{followup}: {error}") from error
    make_folder(out)
    for name, image in (
        ("difference", found.difference_dn),
        ("plain-difference", found.plain_difference_dn),
        ("pose-difference", found.pose_difference_dn),
        ("uncertainty", np.where(found.valid, np.sqrt(found.uncertainty.variance_dn2), 0.0)),
        ("significance", found.significance),
    ):
        description = f"standoff changes: {name} of {followup.name}"
        write_float_tiff(out / f"{name}.tif", image.astype(np.float32), description)
    write_mask(out / "changes.png", found.is_change)
    write_mask(out / "compared.png", found.valid)
    write_file(out / "changes-figure.png", png_bytes(plot_changes(far, found)))
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
            found.extra_blur_err_px2 if np.isfinite(found.extra_blur_err_px2) else None
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
