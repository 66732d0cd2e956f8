"""``standoff simulate``: a photograph as the same camera would take it from further away."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from analysis.choices import CACHE_VARIABLE
from simulation.choices import (
    DEFAULT_MODEL,
    KERNEL_MODELS,
    MODELS,
    POSE_MODELS,
    TRAINING_STEPS,
    GaussianForm,
    KernelModel,
    Model,
    PsfForm,
    Sampler,
)
from standoff.terminal import (
    EncodingName,
    Force,
    Json,
    Mean,
    Option,
    Page,
    ShownProgress,
    Threads,
    TransferForm,
    check_options,
    checked_zoom,
    exactly_one,
    needs,
    note_once,
    print_json,
    reading_options,
    refuse_overwriting,
    refuse_suffix,
    say,
)

if TYPE_CHECKING:
    from standoff.library import CaptureOptions


AnyModel = Literal[Model, KernelModel]

_SHARPENING_SIGMA_PX = 1.0

_POSE, _MODEL = "The other pose", "The model"
_CAMERA, _KERNELGAN = "Effects of the camera", "KernelGAN"

_SHAPES: dict[PsfForm, str] = {
    "gaussian": "Gaussian",
    "separable": "measured along x and y",
    "round": "measured, round",
    "elliptic": "measured, elliptic",
    "free": "measured, free in shape",
}

_RULES = (
    exactly_one("zoom", "homography"),
    needs("homography", Option("model", POSE_MODELS)),
    needs("nearer", "homography"),
    needs(Option("model", tuple(name for name in MODELS if name != "bicubic")), "psf"),
    needs("psf", Option("model", MODELS)),
    needs(Option("gaussian", ("sampled",)), Option("model", ("paper",))),
    needs(
        Option("transfer", ("measured",)),
        Option("model", POSE_MODELS),
        because="only matched and lmmse take a measured PSF",
    ),
    *(
        needs(option, Option("model", KERNEL_MODELS))
        for option in ("steps", "centre_crop", "sampler", "kernel_cache")
    ),
)


def simulate(
    context: typer.Context,
    image: Annotated[Path, typer.Argument(help="The reference photograph.", show_default=False)],
    *,
    out: Annotated[Path, typer.Option(help="Where to write the follow-up (float32 TIFF).")],
    zoom: Annotated[
        float | None,
        typer.Option(
            help="Distance ratio, at least 1.", callback=checked_zoom, rich_help_panel=_POSE
        ),
    ] = None,
    homography: Annotated[
        Path | None,
        typer.Option(help="H.json of another pose, instead of --zoom.", rich_help_panel=_POSE),
    ] = None,
    nearer: Annotated[
        Path | None,
        typer.Option(
            help="Also write a mask (PNG) of pixels sharper than the reference.",
            rich_help_panel=_POSE,
        ),
    ] = None,
    psf: Annotated[
        Path | None, typer.Option(help="psf.json of the camera.", rich_help_panel=_MODEL)
    ] = None,
    model: Annotated[
        AnyModel, typer.Option(help="Capture model.", rich_help_panel=_MODEL)
    ] = DEFAULT_MODEL,
    transfer: TransferForm = "best",
    gaussian: Annotated[
        GaussianForm,
        typer.Option(
            help="Blur by the exact transfer function, or by sampled weights (paper).",
            rich_help_panel=_MODEL,
        ),
    ] = "transfer",
    sharpen: Annotated[
        str | None,
        typer.Option(
            help="Sharpen as a camera does: AMOUNT or AMOUNT,SIGMA_PX.", rich_help_panel=_CAMERA
        ),
    ] = None,
    exposure: Annotated[
        float,
        typer.Option(min=0, help="Exposure relative to the reference.", rich_help_panel=_CAMERA),
    ] = 1.0,
    vignetting: Annotated[
        float,
        typer.Option(
            help="Relative loss of light at the follow-up's corners.", rich_help_panel=_CAMERA
        ),
    ] = 0.0,
    noise: Annotated[
        Path | None,
        typer.Option(
            help="noise.json of the camera, to add the noise of a capture.", rich_help_panel=_CAMERA
        ),
    ] = None,
    correct: Annotated[
        Path | None,
        typer.Option(
            help="noise.json whose dark, flat and defect maps are applied first.",
            rich_help_panel=_CAMERA,
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(min=0, help="Seed for the noise and for training.", rich_help_panel=_CAMERA),
    ] = 0,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help=f"Training steps (kernelgan); {TRAINING_STEPS} by default.",
            rich_help_panel=_KERNELGAN,
        ),
    ] = None,
    centre_crop: Annotated[
        bool,
        typer.Option(
            "--centre-crop",
            "--center-crop",
            help="Train on the central half only (kernelgan).",
            rich_help_panel=_KERNELGAN,
        ),
    ] = False,
    sampler: Annotated[
        Sampler | None,
        typer.Option(
            help="Sample at exact grid points or nearest pixels (kernelgan); exact by default.",
            rich_help_panel=_KERNELGAN,
        ),
    ] = None,
    kernel_cache: Annotated[
        Path | None,
        typer.Option(
            help=f"Folder of trained kernels; ${CACHE_VARIABLE} or the XDG cache by default.",
            rich_help_panel=_KERNELGAN,
        ),
    ] = None,
    threads: Threads = 1,
    encoding: EncodingName = "auto",
    page: Page = None,
    mean: Mean = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Simulate how the scene of a photograph looks from further away or from another pose."""
    check_options(context, _RULES)
    refuse_suffix(out, "--out", {".tif", ".tiff"})
    refuse_suffix(nearer, "--nearer", {".png"})
    refuse_overwriting([out, nearer], [image, psf, noise, homography, correct], force=force)
    from standoff.library import simulate as simulated

    found = simulated(
        image,
        zoom=zoom,
        homography=homography,
        psf=psf,
        model=model,
        transfer=transfer,
        gaussian=gaussian,
        camera=_camera(exposure, vignetting, sharpen, seed),
        noise=noise,
        correct=correct,
        steps=steps or TRAINING_STEPS,
        centre_crop=centre_crop,
        sampler=sampler or "exact",
        kernel_cache=kernel_cache,
        threads=threads,
        reading=reading_options(encoding, page, mean),
        progress=ShownProgress(),
    )
    found.write(out)
    if nearer is not None:
        found.write_nearer(nearer)
    note_once(found.notes)
    if json:
        print_json({"out": str(out), **found.to_json()})
        return
    form = found.followup.psf_form
    shape = "" if form is None else f", PSF: {_SHAPES[form]}"
    cols, rows = found.image.shape[1], found.image.shape[0]
    say(f"wrote {out}: {cols} x {rows} px, {found.how}{shape}")
    masks = found.mask_fractions
    if homography is not None and masks:
        say(
            f"{100 * masks['nearer_fraction']:.1f} % of it would be sharper than the reference, "
            f"{100 * masks['outside_fraction']:.1f} % lies outside the reference (level 0)"
        )


def _camera(exposure: float, vignetting: float, sharpen: str | None, seed: int) -> CaptureOptions:
    from standoff.library import CaptureOptions

    try:
        return CaptureOptions(
            exposure=exposure,
            vignetting=vignetting,
            sharpening=None if sharpen is None else _sharpening(sharpen),
            seed=seed,
        )
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def _sharpening(text: str) -> tuple[float, float]:
    amount, _, sigma_px = text.partition(",")
    if sigma_px and amount.strip() == "0":
        raise typer.BadParameter(
            f"an amount of 0 does not sharpen; write 0.{sigma_px} with a decimal point",
            param_hint="--sharpen",
        )
    try:
        return float(amount), float(sigma_px or _SHARPENING_SIGMA_PX)
    except ValueError as error:
        raise typer.BadParameter(
            f"expected AMOUNT or AMOUNT,SIGMA_PX, got {text}", param_hint="--sharpen"
        ) from error
