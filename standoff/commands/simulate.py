"""``standoff simulate``: a photograph as the same camera would take it from further away."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from analysis.validation import CACHE_VARIABLE, default_cache_folder
from calibration.files import read_correction, read_homography, read_noise, read_psf
from simulation import MODELS, GaussianPsf, Model, PsfField
from simulation.kernelgan import (
    KERNEL_MODELS,
    TRAINING_STEPS,
    KernelGanSettings,
    KernelModel,
    Sampler,
)
from simulation.resampling import GaussianForm
from standoff.errors import ApplicationError
from standoff.terminal import (
    Json,
    checked_zoom,
    note,
    print_json,
    refuse_overwriting,
    refuse_suffix,
    say,
)
from standoff.workflows import (
    CaptureOptions,
    FollowUp,
    FoundKernel,
    captured,
    found_kernel,
    from_pose,
    read_image,
    write_float_tiff,
    write_mask,
    zoomed_out,
    zoomed_out_as_measured,
    zoomed_out_by_kernel,
)

__all__ = ["read_total_psf", "simulate"]

TransferForm = Literal["gaussian", "measured"]
AnyModel = Literal[Model, KernelModel]

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
    model: Annotated[AnyModel, typer.Option(help="Capture model.")] = "matched",
    transfer: Annotated[
        TransferForm,
        typer.Option(help="Take the PSF as a Gaussian, or its e-SFR from psf.json (lmmse)."),
    ] = "gaussian",
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
    correct: Annotated[
        Path | None,
        typer.Option(help="noise.json whose dark, flat and defect maps are taken off first."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise, and of a training.")] = 0,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help=f"Of a training (kernelgan); {TRAINING_STEPS} if none."),
    ] = None,
    centre_crop: Annotated[
        bool, typer.Option("--centre-crop", help="Train on the central half only (kernelgan).")
    ] = False,
    sampler: Annotated[
        Sampler | None,
        typer.Option(
            help="Sample exactly at the grid (if none), or the nearest pixel (kernelgan)."
        ),
    ] = None,
    kernel_cache: Annotated[
        Path | None,
        typer.Option(help=f"Folder of trained kernels; else ${CACHE_VARIABLE} or XDG's cache."),
    ] = None,
    json: Json = False,
) -> None:
    """Simulate how the scene of a photograph looks from further away or from another pose."""
    refuse_overwriting([out, nearer], [image, psf, noise, homography, correct])
    refuse_suffix(out, "--out", {".tif", ".tiff"})
    refuse_suffix(nearer, "--nearer", {".png"})
    if (zoom is None) == (homography is None):
        raise typer.BadParameter("give either --zoom or --homography")
    if homography is not None and model != "matched":
        raise typer.BadParameter("--homography goes with model matched")
    if nearer is not None and homography is None:
        raise typer.BadParameter("--nearer goes with --homography")
    if psf is None and model in _BLURRING_MODELS:
        raise typer.BadParameter(f"model {model} needs --psf psf.json", param_hint="--psf")
    if gaussian == "sampled" and model != "paper":
        raise typer.BadParameter("sampled weights are for model paper", param_hint="--gaussian")
    if transfer == "measured" and (model != "lmmse" or zoom is None):
        raise typer.BadParameter("a measured transfer is for model lmmse", param_hint="--transfer")
    learned = _training_settings(model, zoom, steps, seed, is_centre_crop=centre_crop)
    if learned is None and (steps or centre_crop or sampler or kernel_cache):
        raise typer.BadParameter(
            "--steps, --centre-crop, --sampler and --kernel-cache go with model "
            + " or ".join(KERNEL_MODELS)
        )
    if learned is not None and psf is not None:
        raise typer.BadParameter(f"model {model} takes no PSF", param_hint="--psf")
    try:
        options = CaptureOptions(
            exposure=exposure,
            vignetting=vignetting,
            sharpening=None if sharpen is None else _sharpening(sharpen),
            noise=None if noise is None else read_noise(noise).capture_noise,
            seed=seed,
        )
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    pose = None if homography is None else read_homography(homography)
    reference = _reference(image, correct)
    frame = (reference.shape[1], reference.shape[0])
    is_same_frame = pose is None or pose.size == frame
    camera, measured, found = None, None, None
    plain_model = _without_training(model)
    if psf is not None and transfer == "measured":
        measured = read_psf(psf).measured_transfer(str(psf))
    elif psf is not None and plain_model is not None:
        camera = _camera_psf(psf, frame if is_same_frame else None, plain_model)
    try:
        if learned is not None:
            found = found_kernel(reference, learned, kernel_cache or default_cache_folder())
            simulated = zoomed_out_by_kernel(
                reference, learned.zoom, found.kernel, sampler or "exact", options.noise
            )
        elif measured is not None and zoom is not None:
            simulated = zoomed_out_as_measured(reference, zoom, measured, options.noise)
        elif pose is not None and camera is not None:
            simulated = from_pose(reference, pose, camera, options.noise)
        else:
            assert zoom is not None
            assert plain_model is not None
            simulated = zoomed_out(
                reference, zoom, camera, plain_model, options.noise, gaussian=gaussian
            )
        with np.errstate(over="ignore"):  # levels beyond float32 are refused below
            followup = captured(simulated, options).astype(np.float32, copy=False)
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
    if nearer is not None and simulated.nearer is not None:
        write_mask(nearer, simulated.nearer)
    rows, cols = followup.shape[:2]
    masks = _mask_fractions(simulated) if pose is not None else {}
    if json:
        print_json(
            {
                "out": str(out),
                "image": str(image),
                "zoom": zoom,
                "model": model,
                "transfer": transfer,
                "psf_field": simulated.is_field,
                "size": [cols, rows],
                "min": float(followup.min()),
                "max": float(followup.max()),
                **masks,
                **({} if found is None else _kernel_facts(found)),
            }
        )
        return
    say(f"wrote {out}: {cols} x {rows} px, {place}, model {model}")
    if masks:
        say(
            f"{100 * masks['nearer_fraction']:.1f} % of it would be sharper than the reference, "
            f"{100 * masks['outside_fraction']:.1f} % lies outside the reference (level 0)"
        )


def _reference(image: Path, correct: Path | None) -> NDArray[np.generic]:
    file = read_image(image)
    if correct is None:
        return file.colour_planes
    if file.is_colour:
        raise ApplicationError(f"{image}: the maps are of a grey camera, this is in colour")
    maps = read_correction(correct)
    try:
        return maps.correct(file.colour_planes)
    except ValueError as error:
        raise ApplicationError(f"{image}: {error}") from error


def _training_settings(
    model: AnyModel, zoom: float | None, steps: int | None, seed: int, *, is_centre_crop: bool
) -> KernelGanSettings | None:
    if zoom is None or not (model == "kernelgan" or model == "gaussian-kernelgan"):
        return None
    return KernelGanSettings(
        zoom=zoom,
        model=model,
        steps=steps or TRAINING_STEPS,
        seed=seed,
        is_centre_crop=is_centre_crop,
    )


def _without_training(model: AnyModel) -> Model | None:
    return None if model == "kernelgan" or model == "gaussian-kernelgan" else model


def _kernel_facts(found: FoundKernel) -> dict[str, Any]:
    return {
        "kernel": str(found.path),
        "kernel_from_cache": found.is_from_cache,
        "kernel_covariance_px2": found.kernel.covariance_px2.tolist(),
    }


def _mask_fractions(simulated: FollowUp) -> dict[str, float]:
    return {
        f"{name}_fraction": float(mask.mean())
        for name, mask in (("nearer", simulated.nearer), ("outside", simulated.outside))
        if mask is not None
    }


def _camera_psf(path: Path, frame: tuple[int, int] | None, model: Model) -> GaussianPsf | PsfField:
    """PSF of a psf.json: its field where the model and the frames allow it, else the one PSF."""
    field = read_psf(path).total_field(str(path))
    if field is None:
        return read_total_psf(path)
    if model != "matched":
        note(f"{path}: model {model} takes the PSF of the whole frame, not its field")
    elif frame != (field.width_px, field.height_px):
        note(
            f"{path}: its field belongs to frames of {field.width_px} x {field.height_px} px; "
            "the PSF of the whole frame is taken"
        )
    else:
        return field
    return read_total_psf(path)


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
