"""``standoff simulate``: a photograph as the same camera would take it from further away."""

from functools import partial
from math import inf
from pathlib import Path
from typing import Annotated, Literal

from typer import BadParameter, Option

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
_depth = partial(Option, rich_help_panel="A scene with depth")
_model = partial(Option, rich_help_panel="The model")
_camera = partial(Option, rich_help_panel="Effects of the camera")
_uncertainty = partial(Option, rich_help_panel="The uncertainty")
_kernelgan = partial(Option, rich_help_panel="KernelGAN")

_SHAPES: dict[PsfForm, str] = {
    "gaussian": "Gaussian",
    "separable": "measured along x and y",
    "round": "measured, round",
    "elliptic": "measured, elliptic",
    "free": "measured, of free shape",
    "own": "your own",
}


def _noise_or_number(text: str | None) -> Path | float | None:
    if text is None:
        return None
    try:
        level_dn = float(text)
    except ValueError:
        return Path(text)
    if not 0 <= level_dn < inf:
        raise BadParameter(
            f"a standard deviation must not be negative, got {text}", param_hint="--reference-noise"
        )
    return level_dn


@terminal.command(
    terminal.exactly_one("zoom", "homography"),
    terminal.needs("homography", terminal.Given("model", POSE_MODELS)),
    terminal.needs("nearer", "homography", "depth"),
    terminal.needs("depth", terminal.Given("model", POSE_MODELS)),
    terminal.needs("hidden", "depth"),
    terminal.needs("plane_depth", "depth"),
    terminal.needs("focal_length_px", "depth"),
    terminal.excludes("depth", "uncertainty", because="the uncertainty of the depth is not known"),
    terminal.needs(
        terminal.Given("model", tuple(name for name in MODELS if name != "bicubic")), "psf"
    ),
    terminal.needs("psf", terminal.Given("model", MODELS)),
    terminal.needs("focus_scatter", "uncertainty"),
    terminal.needs("reference_noise", "uncertainty"),
    terminal.needs(
        "uncertainty",
        terminal.Given("model", tuple(name for name in MODELS if name != "bicubic")),
        because="the other models have no kernel through which errors propagate",
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
    image: Path,
    *,
    out: Annotated[Path, terminal.Result(".tif", ".tiff")],
    zoom: Annotated[float | None, _pose(callback=terminal.checked_zoom)] = None,
    homography: Annotated[Path | None, _pose()] = None,
    nearer: Annotated[Path | None, _pose(), terminal.Result(".png")] = None,
    depth: Annotated[Path | None, _depth()] = None,
    focal_length_px: Annotated[
        float | None, _depth(parser=terminal.quantity("focal_length_px"))
    ] = None,
    plane_depth: Annotated[float | None, _depth()] = None,
    hidden: Annotated[Path | None, _depth(), terminal.Result(".png")] = None,
    psf: Annotated[Path | None, _model()] = None,
    model: Annotated[AnyModel, _model()] = DEFAULT_MODEL,
    transfer: terminal.TransferForm = "best",
    gaussian: Annotated[GaussianForm, _model()] = "transfer",
    sharpen: Annotated[str | None, _camera()] = None,
    exposure: Annotated[float, _camera(min=0)] = 1.0,
    vignetting: Annotated[float, _camera()] = 0.0,
    noise: Annotated[Path | None, _camera()] = None,
    correct: Annotated[Path | None, _camera()] = None,
    uncertainty: Annotated[Path | None, _uncertainty(), terminal.Result(".tif", ".tiff")] = None,
    reference_noise: Annotated[str | None, _uncertainty(callback=_noise_or_number)] = None,
    focus_scatter: Annotated[float | None, _uncertainty(min=0, metavar="PX2")] = None,
    seed: Annotated[int, _camera(min=0)] = 0,
    steps: Annotated[
        int | None,
        _kernelgan(min=1, help=f"Training steps (kernelgan); {TRAINING_STEPS} by default."),
    ] = None,
    centre_crop: Annotated[bool, _kernelgan("--centre-crop", "--center-crop")] = False,
    sampler: Annotated[Sampler | None, _kernelgan()] = None,
    kernel_cache: Annotated[
        Path | None,
        _kernelgan(
            help=f"Folder of trained kernels; ${CACHE_VARIABLE} or the XDG cache by default."
        ),
    ] = None,
    threads: terminal.Threads = 1,
    reading: terminal.Reading,
) -> None:
    """Simulate how the scene of a photograph looks from further away or from another pose.

    Options
    -------
    image: The reference photograph.
    out: Where to write the follow-up (float32 TIFF).
    zoom: Distance ratio, at least 1.
    homography: H.json of another pose, instead of --zoom.
    nearer: Also write a mask (PNG) of the pixels that should be sharper than the reference.
    depth: Depth of what the reference shows: a map of distances along the optical axis in any unit
        (TIFF or PNG of the reference's size), or a list of planes (JSON).
    focal_length_px: Focal length in px; needed for --homography with --depth.
    plane_depth: Depth of the plane of --homography or --zoom, parallel to the sensor; by default
        the plane that most of the scene lies on.
    hidden: Also write a mask (PNG) of the pixels that show what the reference does not.
    psf: psf.json, or a PSF of your own.
    model: Capture model.
    gaussian: Blur by the exact transfer function, or by sampled weights (paper).
    sharpen: Sharpen as a camera does: AMOUNT or AMOUNT,SIGMA_PX.
    exposure: Exposure relative to the reference.
    vignetting: Relative loss of light at the follow-up's corners.
    noise: noise.json of the camera, to add the noise of a capture.
    correct: noise.json whose dark, flat and defect maps are applied first.
    uncertainty: Also write the standard error of each pixel (float32 TIFF).
    reference_noise: Noise of the reference: noise.json of the camera, or a standard deviation in
        DN; by default that of --noise, or of a capture with several frames.
    focus_scatter: Standard deviation of the PSF's variance from capture to capture, due to focus;
        by default that of psf.json.
    seed: Seed for the noise and for training.
    centre_crop: Train on the central half only (kernelgan).
    sampler: Sample at exact grid points or nearest pixels (kernelgan); exact by default.
    """
    try:
        camera = library.CaptureOptions(
            exposure=exposure,
            vignetting=vignetting,
            sharpening=None if sharpen is None else _sharpening(sharpen),
            seed=seed,
        )
    except ValueError as error:
        raise BadParameter(str(error)) from error
    how = terminal.keywords_of(
        library.simulate,
        camera=camera,
        depth=None
        if depth is None
        else library.read_depth(depth, focal_length_px=focal_length_px, plane_depth=plane_depth),
        steps=steps or TRAINING_STEPS,
        sampler=sampler or "exact",
        uncertainty=None
        if uncertainty is None
        else library.UncertaintyOptions(
            reference_noise=reference_noise, focus_scatter_px2=focus_scatter
        ),
    )
    found = library.simulate(image, **how)
    found.write(out)
    if nearer is not None:
        found.write_nearer(nearer)
    if hidden is not None:
        found.write_hidden(hidden)
    if uncertainty is not None:
        found.write_uncertainty(uncertainty)
    terminal.answer(
        lambda: {"out": str(out), **found.to_json()},
        lambda: _say(found, out, uncertainty),
        found.notes,
    )


def _say(found: "library.SimulatedPhotograph", out: Path, uncertainty: Path | None) -> None:
    form = found.followup.psf_form
    shape = "" if form is None else f", PSF: {_SHAPES[form]}"
    rows, cols = found.image.shape[:2]
    terminal.say(f"wrote {out}: {cols} x {rows} px, {found.how}{shape}")
    masks = found.mask_fractions
    if masks:
        terminal.say(
            f"{100 * masks['nearer_fraction']:.1f} % of it would be sharper than the reference, "
            f"{100 * masks['outside_fraction']:.1f} % lies outside the reference (level 0)"
        )
    if "hidden_fraction" in masks:
        terminal.say(
            f"{100 * masks['hidden_fraction']:.1f} % shows what was hidden from the reference, or "
            "lies at an unknown depth (level 0)"
        )
    if found.uncertainty is not None:
        terminal.say(f"wrote {uncertainty}: {found.uncertainty.sentence}")


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
