"""``standoff pose``: whether a follow-up's pose allows the comparison."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from analysis.pose_plots import plot_pose
from analysis.pose_quality import Criterion, PoseQuality, judge_pose
from analysis.report_page import png_bytes, svg_bytes
from calibration.errors import CalibrationError
from calibration.registration import register
from standoff.commands.simulate import read_total_psf
from standoff.curve_options import (
    CurveContrast,
    CurveModel,
    CurveNoise,
    CurveObserver,
    CurvesPath,
    MinDprime,
    chosen_curve,
)
from standoff.image_files import read_grey
from standoff.options import Json, refuse_overwriting, refuse_suffix
from standoff.output import note, print_json, say
from standoff.reports import require_writable, write_file

__all__ = ["pose"]


def pose(
    reference: Annotated[Path, typer.Argument(help="The earlier, nearer image.")],
    followup: Annotated[Path, typer.Argument(help="The image whose pose is judged.")],
    *,
    curves: CurvesPath,
    min_dprime: MinDprime,
    criterion: Annotated[
        Criterion,
        typer.Option(help="d' reaches the threshold everywhere (min) or in 95 % (quantile)."),
    ] = "min",
    psf: Annotated[Path | None, typer.Option(help="psf.json: a finer registration.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Map to write: PNG or SVG.")] = None,
    model: CurveModel = None,
    observer: CurveObserver = None,
    noise: CurveNoise = None,
    contrast: CurveContrast = None,
    json: Json = False,
) -> None:
    """Accept or reject a follow-up's pose by the d' that it allows at every place."""
    refuse_suffix(picture, "--picture", {".png", ".svg"})
    refuse_overwriting([picture], [reference, followup, curves, psf])
    require_writable([picture])
    curve = chosen_curve(curves, min_dprime, model, observer, noise, contrast)
    near, far = read_grey(reference), read_grey(followup)
    try:
        found = register(near, far, None if psf is None else read_total_psf(psf))
    except CalibrationError as error:
        raise CalibrationError(f"{followup}: {error}") from error
    quality = judge_pose(
        found.matrix,
        (far.shape[1], far.shape[0]),
        (near.shape[1], near.shape[0]),
        curve,
        min_dprime,
        criterion,
    )
    if quality.beyond_curve:
        note(
            f"{100 * quality.beyond_curve:.0f} % of the overlap lies beyond the curve's zoom of "
            f"{curve.zoom[-1]:g}; its d' is taken as 0"
        )
    if picture is not None:
        figure = plot_pose(far, quality)
        write_file(picture, svg_bytes(figure) if picture.suffix == ".svg" else png_bytes(figure))
    facts = _facts(quality)
    if json:
        print_json(
            {
                "is_accepted": quality.is_accepted,
                "criterion": criterion,
                "min_dprime": min_dprime,
                "curve": curve.model_dump(include={"model", "observer", "noise_dn", "contrast_dn"}),
                "is_upper_bound": True,
                **facts,
                "homography": found.matrix.tolist(),
                "registration_correlation": found.correlation,
                "picture": None if picture is None else str(picture),
            }
        )
        return
    say(
        f"{'accepted' if quality.is_accepted else 'rejected'}: {criterion} d' "
        f"{quality.decisive_d_prime:.2f}, threshold {min_dprime:g} ({curve.name})"
    )
    say(
        f"local zoom {facts['zoom_min']:.3f} to {facts['zoom_max']:.3f}, anisotropy up to "
        f"{facts['anisotropy_max']:.3f}, overlap {100 * facts['overlap']:.0f} % of the follow-up"
    )
    say("d' is an upper bound: registration, light, gloss, parallax and defocus only lower it")


def _facts(quality: PoseQuality) -> dict[str, float]:
    sampling, inside = quality.sampling, quality.sampling.inside
    return {
        "dprime_decisive": quality.decisive_d_prime,
        "dprime_min": float(np.nanmin(quality.d_prime)),
        "dprime_max": float(np.nanmax(quality.d_prime)),
        "zoom_min": float(sampling.best_zoom[inside].min()),
        "zoom_max": float(sampling.worst_zoom[inside].max()),
        "anisotropy_max": float(sampling.anisotropy[inside].max()),
        "overlap": sampling.overlap,
        "beyond_curve": quality.beyond_curve,
    }
