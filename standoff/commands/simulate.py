"""``standoff simulate``: a photograph as the same camera would take it from further away."""

from functools import partial
from math import inf
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, BadParameter, Context, Option

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
from standoff import library, terminal

AnyModel = Literal[Model, KernelModel]

_SHARPENING_SIGMA_PX = 1.0

_pose = partial(Option, rich_help_panel="The other pose")
_model = partial(Option, rich_help_panel="The model")
_camera = partial(Option, rich_help_panel="Effects of the camera")
_uncertainty = partial(Option, rich_help_panel="The uncertainty")
_kernelgan = partial(Option, rich_help_panel="KernelGAN")

_SHAPES: dict[PsfForm, str] = {
    "gaussian": "Gaussian",
    "separable": "measured along x and y",
    "round": "measured, round",
    "elliptic": "measured, elliptic",
    "free": "measured, free in shape",
    "own": "your own",
}

_RULES = (
    terminal.exactly_one("zoom", "homography"),
    terminal.needs("homography", terminal.Given("model", POSE_MODELS)),
    terminal.needs("nearer", "homography"),
    terminal.needs(
        terminal.Given("model", tuple(name for name in MODELS if name != "bicubic")), "psf"
    ),
    terminal.needs("psf", terminal.Given("model", MODELS)),
    terminal.needs("focus_scatter", "uncertainty"),
    terminal.needs("reference_noise", "uncertainty"),
    terminal.needs(
        "uncertainty",
        terminal.Given("model", tuple(name for name in MODELS if name != "bicubic")),
        because="the other models state no kernel that errors could be followed through",
    ),
    terminal.needs(terminal.Given("gaussian", ("sampled",)), terminal.Given("model", ("paper",))),
    terminal.needs(
        terminal.Given("transfer", ("measured",)),
        terminal.Given("model", POSE_MODELS),
        because="only matched and lmmse take a measured PSF",
    ),
    *(
        terminal.needs(option, terminal.Given("model", KERNEL_MODELS))
        for option in ("steps", "centre_crop", "sampler", "kernel_cache")
    ),
)


def simulate(
    context: Context,
    image: Annotated[Path, Argument(help="The reference photograph.", show_default=False)],
    *,
    out: Annotated[Path, Option(help="Where to write the follow-up (float32 TIFF).")],
    zoom: Annotated[
        float | None, _pose(help="Distance ratio, at least 1.", callback=terminal.checked_zoom)
    ] = None,
    homography: Annotated[
        Path | None, _pose(help="H.json of another pose, instead of --zoom.")
    ] = None,
    nearer: Annotated[
        Path | None, _pose(help="Also write a mask (PNG) of pixels sharper than the reference.")
    ] = None,
    psf: Annotated[Path | None, _model(help="psf.json, or a PSF of your own.")] = None,
    model: Annotated[AnyModel, _model(help="Capture model.")] = DEFAULT_MODEL,
    transfer: terminal.TransferForm = "best",
    gaussian: Annotated[
        GaussianForm,
        _model(help="Blur by the exact transfer function, or by sampled weights (paper)."),
    ] = "transfer",
    sharpen: Annotated[
        str | None, _camera(help="Sharpen as a camera does: AMOUNT or AMOUNT,SIGMA_PX.")
    ] = None,
    exposure: Annotated[float, _camera(min=0, help="Exposure relative to the reference.")] = 1.0,
    vignetting: Annotated[
        float, _camera(help="Relative loss of light at the follow-up's corners.")
    ] = 0.0,
    noise: Annotated[
        Path | None, _camera(help="noise.json of the camera, to add the noise of a capture.")
    ] = None,
    correct: Annotated[
        Path | None, _camera(help="noise.json whose dark, flat and defect maps are applied first.")
    ] = None,
    uncertainty: Annotated[
        Path | None,
        _uncertainty(help="Also write the standard error of each pixel (float32 TIFF)."),
    ] = None,
    reference_noise: Annotated[
        str | None,
        _uncertainty(
            help="Noise of the reference: noise.json of the camera, or a standard deviation in "
            "DN; by default that of --noise, or of a capture with several frames."
        ),
    ] = None,
    focus_scatter: Annotated[
        float | None,
        _uncertainty(
            min=0,
            metavar="PX2",
            help="Standard deviation of the PSF's variance from capture to capture, by focus; by "
            "default that of psf.json.",
        ),
    ] = None,
    seed: Annotated[int, _camera(min=0, help="Seed for the noise and for training.")] = 0,
    steps: Annotated[
        int | None,
        _kernelgan(min=1, help=f"Training steps (kernelgan); {TRAINING_STEPS} by default."),
    ] = None,
    centre_crop: Annotated[
        bool,
        _kernelgan(
            "--centre-crop", "--center-crop", help="Train on the central half only (kernelgan)."
        ),
    ] = False,
    sampler: Annotated[
        Sampler | None,
        _kernelgan(
            help="Sample at exact grid points or nearest pixels (kernelgan); exact by default."
        ),
    ] = None,
    kernel_cache: Annotated[
        Path | None,
        _kernelgan(
            help=f"Folder of trained kernels; ${CACHE_VARIABLE} or the XDG cache by default."
        ),
    ] = None,
    threads: terminal.Threads = 1,
    encoding: terminal.EncodingName = "auto",
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Simulate how the scene of a photograph looks from further away or from another pose."""
    terminal.check_options(context, _RULES)
    terminal.refuse_suffix(out, "--out", {".tif", ".tiff"})
    terminal.refuse_suffix(nearer, "--nearer", {".png"})
    terminal.refuse_suffix(uncertainty, "--uncertainty", {".tif", ".tiff"})
    reference = None if reference_noise is None else _noise_or_number(reference_noise)
    read = [image, psf, noise, homography, correct]
    read += [reference] if isinstance(reference, Path) else []
    terminal.refuse_overwriting([out, nearer, uncertainty], read, force=force)
    library.require_writable([out, nearer, uncertainty])
    try:
        camera = library.CaptureOptions(
            exposure=exposure,
            vignetting=vignetting,
            sharpening=None if sharpen is None else _sharpening(sharpen),
            seed=seed,
        )
    except ValueError as error:
        raise BadParameter(str(error)) from error
    found = library.simulate(
        image,
        zoom=zoom,
        homography=homography,
        psf=psf,
        model=model,
        transfer=transfer,
        gaussian=gaussian,
        camera=camera,
        noise=noise,
        correct=correct,
        steps=steps or TRAINING_STEPS,
        centre_crop=centre_crop,
        sampler=sampler or "exact",
        kernel_cache=kernel_cache,
        uncertainty=None
        if uncertainty is None
        else library.UncertaintyOptions(reference_noise=reference, focus_scatter_px2=focus_scatter),
        threads=threads,
        reading=terminal.reading_options(encoding, page, mean),
        progress=terminal.ShownProgress(),
    )
    found.write(out)
    if nearer is not None:
        found.write_nearer(nearer)
    if uncertainty is not None:
        found.write_uncertainty(uncertainty)
    terminal.note_once(found.notes)
    if json:
        terminal.print_json({"out": str(out), **found.to_json()})
        return
    _say(found, out, uncertainty)


def _say(found: "library.SimulatedPhotograph", out: Path, uncertainty: Path | None) -> None:
    form = found.followup.psf_form
    shape = "" if form is None else f", PSF: {_SHAPES[form]}"
    rows, cols = found.image.shape[:2]
    terminal.say(f"wrote {out}: {cols} x {rows} px, {found.how}{shape}")
    masks = found.mask_fractions
    if found.zoom is None and masks:
        terminal.say(
            f"{100 * masks['nearer_fraction']:.1f} % of it would be sharper than the reference, "
            f"{100 * masks['outside_fraction']:.1f} % lies outside the reference (level 0)"
        )
    if found.uncertainty is not None:
        terminal.say(f"wrote {uncertainty}: {found.uncertainty.sentence}")


def _noise_or_number(text: str) -> Path | float:
    try:
        level_dn = float(text)
    except ValueError:
        return Path(text)
    if not 0 <= level_dn < inf:
        raise BadParameter(
            f"a standard deviation must not be negative, got {text}", param_hint="--reference-noise"
        )
    return level_dn


def _sharpening(text: str) -> tuple[float, float]:
    amount, _, sigma_px = text.partition(",")
    if sigma_px and amount.strip() == "0":
        raise BadParameter(
            f"an amount of 0 does not sharpen; write 0.{sigma_px} with a decimal point",
            param_hint="--sharpen",
        )
    try:
        return float(amount), float(sigma_px or _SHARPENING_SIGMA_PX)
    except ValueError as error:
        raise BadParameter(
            f"expected AMOUNT or AMOUNT,SIGMA_PX, got {text}", param_hint="--sharpen"
        ) from error
