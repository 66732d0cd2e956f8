"""``standoff simulate``: a photograph as the same camera would take it from further away."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

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
    Threads,
    TransferForm,
    check_options,
    checked_zoom,
    command_line,
    exactly_one,
    needs,
    photograph_inputs,
    print_json,
    refuse_overwriting,
    refuse_suffix,
    say,
)

if TYPE_CHECKING:
    from standoff.workflows import CaptureOptions, FollowUp, FoundKernel, SimulatedPhotograph


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
    from standoff.workflows import (
        FollowUpRequest,
        simulate_photograph,
        write_float_tiff,
        write_mask,
    )

    inputs = photograph_inputs(encoding, page, mean, files=(psf, noise, homography, correct))
    simulated = simulate_photograph(
        FollowUpRequest(
            image=image,
            inputs=inputs,
            model=model,
            camera=_camera(exposure, vignetting, sharpen, noise, seed),
            zoom=zoom,
            homography=homography,
            psf=psf,
            transfer=transfer,
            gaussian=gaussian,
            correct=correct,
            steps=steps or TRAINING_STEPS,
            is_centre_crop=centre_crop,
            sampler=sampler or "exact",
            kernel_cache=kernel_cache,
            threads=threads,
        )
    )
    pose = f"homography {homography.name}" if homography else f"zoom {zoom!r}"
    written, followup = simulated.image, simulated.followup
    write_float_tiff(out, written, f"standoff simulate: {pose}, model {model}, of {image.name}")
    if nearer is not None and followup.nearer is not None:
        write_mask(nearer, followup.nearer)
    masks = _mask_fractions(followup) if homography else {}
    if json:
        print_json(
            {
                "out": str(out),
                "image": str(image),
                "zoom": zoom,
                "model": model,
                **_psf_facts(followup),
                "size": [written.shape[1], written.shape[0]],
                "min": float(written.min()),
                "max": float(written.max()),
                **masks,
                **_kernel_facts(simulated.kernel),
                "provenance": inputs.provenance(command_line()).model_dump(mode="json"),
            }
        )
        return
    _say_written(out, simulated, f"{pose}, model {model}", masks)


def _say_written(
    out: Path, simulated: SimulatedPhotograph, how: str, masks: dict[str, float]
) -> None:
    written, form = simulated.image, simulated.followup.psf_form
    shape = "" if form is None else f", PSF: {_SHAPES[form]}"
    say(f"wrote {out}: {written.shape[1]} x {written.shape[0]} px, {how}{shape}")
    if masks:
        say(
            f"{100 * masks['nearer_fraction']:.1f} % of it would be sharper than the reference, "
            f"{100 * masks['outside_fraction']:.1f} % lies outside the reference (level 0)"
        )


def _psf_facts(followup: FollowUp) -> dict[str, Any]:
    form = followup.psf_form
    return {
        "transfer": "gaussian" if form in (None, "gaussian") else "measured",
        "psf_form": form,
        "psf_field": followup.is_field,
    }


def _camera(
    exposure: float, vignetting: float, sharpen: str | None, noise: Path | None, seed: int
) -> CaptureOptions:
    from calibration.files import read_noise
    from standoff.workflows import CaptureOptions

    try:
        return CaptureOptions(
            exposure=exposure,
            vignetting=vignetting,
            sharpening=None if sharpen is None else _sharpening(sharpen),
            noise=None if noise is None else read_noise(noise).capture_noise,
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


def _kernel_facts(found: FoundKernel | None) -> dict[str, Any]:
    if found is None:
        return {}
    return {
        "kernel": str(found.path),
        "kernel_from_cache": found.is_from_cache,
        "kernel_covariance_px2": found.kernel.covariance_px2.tolist(),
    }


def _mask_fractions(followup: FollowUp) -> dict[str, float]:
    return {
        f"{name}_fraction": float(mask.mean())
        for name, mask in (("nearer", followup.nearer), ("outside", followup.outside))
        if mask is not None
    }
