"""``standoff simulate``: a photograph as the same camera would take it from further away."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from calibration.files import read_homography, read_noise, read_psf
from simulation import MODELS, GaussianPsf, Model, simulate_pose, zoom_out
from simulation.gaussian_kernel import GaussianForm
from standoff.errors import ApplicationError
from standoff.followup import CaptureOptions, captured, own_variance
from standoff.image_files import read_image, write_float_tiff, write_mask
from standoff.options import Json, checked_zoom, refuse_overwriting
from standoff.output import note, print_json, say

__all__ = ["read_total_psf", "simulate"]

_SHARPENING_SIGMA_PX = 1.0
_BLURRING_MODELS = tuple(name for name in MODELS if name != "bicubic")


def simulate(
    image: Annotated[Path, typer.Argument(help="The reference photograph.", show_default=False)],
    *,
    out: Annotated[Path, typer.Option(help="Where to write the follow-up: float32 TIFF.")],
    zoom: Annotated[
        float | None,
        typer.Option(help="How many times further away, at least 1.", callback=checked_zoom),
    ] = None,
    homography: Annotated[
        Path | None, typer.Option(help="H.json: any other pose, instead of --zoom.")
    ] = None,
    nearer: Annotated[
        Path | None,
        typer.Option(help="PNG mask of where the follow-up would be sharper (--homography)."),
    ] = None,
    psf: Annotated[Path | None, typer.Option(help="psf.json of the camera.")] = None,
    model: Annotated[Model, typer.Option(help="Capture model.")] = "matched",
    gaussian: Annotated[
        GaussianForm,
        typer.Option(help="Blur by the exact transfer function, or by sampled weights."),
    ] = "transfer",
    sharpen: Annotated[
        str | None, typer.Option(help="Sharpen like a camera: AMOUNT or AMOUNT,SIGMA_PX.")
    ] = None,
    exposure: Annotated[float, typer.Option(min=0, help="Times the light of the reference.")] = 1.0,
    vignetting: Annotated[
        float, typer.Option(help="Relative loss of light at the follow-up's corner.")
    ] = 0.0,
    noise: Annotated[
        Path | None, typer.Option(help="noise.json: give the follow-up a capture's noise.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 0,
    json: Json = False,
) -> None:
    """Simulate how the scene of a photograph looks from further away or from another pose."""
    refuse_overwriting([out, nearer], [image, psf, noise, homography])
    if (zoom is None) == (homography is None):
        raise typer.BadParameter("give either --zoom or --homography")
    if homography is not None and (model != "matched" or noise is not None):
        raise typer.BadParameter("--homography goes with model matched and without --noise")
    if nearer is not None and homography is None:
        raise typer.BadParameter("--nearer goes with --homography")
    if psf is None and model in _BLURRING_MODELS:
        raise typer.BadParameter(f"model {model} needs --psf psf.json", param_hint="--psf")
    if gaussian == "sampled" and model != "paper":
        raise typer.BadParameter("sampled weights are for model paper", param_hint="--gaussian")
    total = None if psf is None else read_total_psf(psf)
    options = CaptureOptions(
        exposure=exposure,
        vignetting=vignetting,
        sharpening=None if sharpen is None else _sharpening(sharpen),
        noise=None if noise is None else read_noise(noise),
        seed=seed,
    )
    reference = read_image(image).colour_planes
    pose = None if homography is None else read_homography(homography)
    simulated = None
    masks: dict[str, float] = {}
    try:
        if pose is not None:
            simulated = simulate_pose(
                reference, pose.matrix, (pose.width_px, pose.height_px), total
            )
            followup, own = simulated.image, None
            masks = {
                "nearer_fraction": float(simulated.nearer.mean()),
                "outside_fraction": float(simulated.outside.mean()),
            }
        else:
            followup = zoom_out(reference, zoom or 1.0, total, model, gaussian=gaussian)
            own = None
            if options.noise is not None:
                own = own_variance(reference, zoom or 1.0, total, model, options.noise)
        with np.errstate(over="ignore"):  # levels beyond float32 are refused below
            followup = captured(followup, options, own).astype(np.float32, copy=False)
    except ValueError as error:
        raise ApplicationError(f"{homography or image}: {error}") from error
    if not np.all(np.isfinite(followup)):
        raise ApplicationError(f"{image}: the follow-up's levels leave float32; lower --exposure")
    place = f"homography {homography.name}" if homography else f"zoom {zoom!r}"
    write_float_tiff(
        out,
        followup,
        f"standoff simulate: {place}, model {model}, of {image.name}",
    )
    if nearer is not None and simulated is not None:
        write_mask(nearer, simulated.nearer)
    rows, cols = followup.shape[:2]
    if json:
        print_json(
            {
                "out": str(out),
                "image": str(image),
                "zoom": zoom,
                "model": model,
                "size": [cols, rows],
                "min": float(followup.min()),
                "max": float(followup.max()),
                **masks,
            }
        )
        return
    say(f"wrote {out}: {cols} x {rows} px, {place}, model {model}")
    if masks:
        say(
            f"{100 * masks['nearer_fraction']:.1f} % of it would be sharper than the reference, "
            f"{100 * masks['outside_fraction']:.1f} % lies outside the reference (level 0)"
        )


def _sharpening(text: str) -> tuple[float, float]:
    amount, _, sigma_px = text.partition(",")
    try:
        return float(amount), float(sigma_px or _SHARPENING_SIGMA_PX)
    except ValueError as error:
        raise typer.BadParameter(
            f"expected AMOUNT or AMOUNT,SIGMA_PX, got {text}", param_hint="--sharpen"
        ) from error


def read_total_psf(path: Path) -> GaussianPsf:
    """Read the total PSF of a psf.json, with a note where its correlation is taken as none.

    Raises
    ------
    PsfFileError
        If the file cannot be read or lacks a width.
    """
    stored = read_psf(path)
    total = stored.total_psf(str(path))
    if stored.rho is None:
        note(f"{path}: rho is null (no diagonal edges); taken as 0, an axis-aligned PSF")
    return total
