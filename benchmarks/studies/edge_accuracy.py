"""How near the edge measurement comes to what the pixels hold: noise-free bias, noise, covariance.

Every truth is a closed form or a quadrature written for the tests. Errors in noise are RMS over
the Cramer-Rao bound: of all pixels of the image within 6 sigma + 3 px of the true edge, with angle,
place, curvature, width and both levels unknown, from numerical derivatives. Nothing unbiased is
below 1; of N edges the figure itself scatters by 1 / sqrt(2 N).

    python -m benchmarks.studies.edge_accuracy [--edges 2000] [--draws 200] [--quick]
"""

from math import hypot, sqrt
from typing import Annotated

import numpy as np

from benchmarks.harness import Recorder, benchmark
from benchmarks.scoring import Errors
from benchmarks.truth.edges import exact_edge
from calibration.edges import EdgeFit, find_edges, fit_edge
from calibration.noise import LevelNoise
from calibration.psf import fit_covariance
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image

SIDE_PX = 100
LOW_DN, HIGH_DN = 8_000.0, 52_000.0
CONTRAST_DN = HIGH_DN - LOW_DN
PIXEL_SIGMA_PX = sqrt(1 / 12)


def _line(errors: Errors) -> str:
    """Bias, scatter, RMS over the bound, coverage and what was missed."""
    bias, scatter = 100 * np.mean(errors.relative), 100 * np.std(errors.relative)
    return (
        f"{bias:8.3f} {scatter:9.3f} {errors.rms:10.3f} {errors.coverage:9.1f} {errors.missed:7d}"
    )


def _only_fit(image: FloatArray, noise: LevelNoise | None = None) -> EdgeFit | None:
    segments = find_edges(image, cell_px=1000.0)
    return fit_edge(image, segments[0], noise=noise) if len(segments) == 1 else None


def _noise_free(record: Recorder) -> None:
    record.say("\nnoise-free, normals of 0 to 90 degrees in steps of 1: worst error of sigma in %")
    record.say(
        "  sigma   point-sampled, total   pixel square, optical   the same in 16 bit  missed"
    )
    for sigma_px in record.pick((0.3, 0.4, 0.5, 0.8, 1.5, 2.5), (0.5, 1.5)):
        worst, missed = [0.0, 0.0, 0.0], 0
        for normal_deg in range(0, 91, record.pick(1, 5)):
            square = edge_image(sigma_px, normal_deg, has_pixel=True)
            for k, image in enumerate((edge_image(sigma_px, normal_deg), square, np.rint(square))):
                if k == 0 and sigma_px < 0.4:
                    continue
                fit = _only_fit(image)
                width = None if fit is None else (fit.sigma_px, fit.optical_sigma_px)[k > 0]
                if width is None:
                    missed += 1
                else:
                    worst[k] = max(worst[k], abs(width / sigma_px - 1))
        record.figure(f"worst error without noise, sigma {sigma_px} px", 100 * worst[1], "%")
        first = f"{100 * worst[0]:.4f}" if sigma_px >= 0.4 else "-"
        record.say(
            f"  {sigma_px:5.2f} {first:>22} {100 * worst[1]:23.4f} {100 * worst[2]:20.4f}"
            f" {missed:7d}"
        )


def _bound_px(truth: FloatArray, x: FloatArray, y: FloatArray, noise_dn: FloatArray) -> float:
    """Cramer-Rao bound of sigma's standard deviation; ``noise_dn`` of each pixel."""
    steps = np.array([1e-6, 1e-5, 1e-8, 1e-5, 1e-1, 1e-1])
    jacobian = np.column_stack(
        [
            (exact_edge(truth + shift, x, y) - exact_edge(truth - shift, x, y)) / (2 * step)
            for shift, step in zip(np.diag(steps), steps, strict=True)
        ]
    )
    weighted = jacobian / noise_dn[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    inverse = np.linalg.inv((weighted / scale).T @ (weighted / scale))
    return float(np.exp(truth[3]) * np.sqrt(inverse[3, 3]) / scale[3])


def _noisy_cell(
    sigma_px: float, snr: float, edges: int, *, is_shot: bool = False, length_px: int = SIDE_PX
) -> Errors:
    """Optical widths of edges at random angles and places in white noise, or in shot noise."""
    rng = np.random.default_rng([round(1000 * sigma_px), round(snr), length_px, is_shot])
    errors = Errors()
    y, x = np.mgrid[:length_px, :length_px] - (length_px - 1) / 2
    reach_px = 6 * hypot(sigma_px, PIXEL_SIGMA_PX) + 3
    mean_variance = (CONTRAST_DN / snr) ** 2
    for _ in range(edges):
        angle = rng.uniform(0, 2 * np.pi)
        offset = rng.uniform(-0.1, 0.1) * length_px
        truth = np.array([angle, offset, 0.0, np.log(sigma_px), LOW_DN, HIGH_DN])
        clean = exact_edge(truth, x, y)
        variance = np.full(clean.shape, mean_variance)
        line = None
        if is_shot:
            # 15 times the variance on the bright side, the same mean as in white noise.
            slope = 14 / 8 * mean_variance / CONTRAST_DN
            offset_dn2 = mean_variance / 8 - slope * LOW_DN
            variance = offset_dn2 + slope * clean
            line = LevelNoise(offset_dn2=offset_dn2, slope_dn=slope, floor_dn2=1.0)
        image = clean + rng.standard_normal(clean.shape) * np.sqrt(variance)
        fit = _only_fit(image, line)
        if fit is None or fit.optical_sigma_px is None or fit.optical_sigma_err_px is None:
            errors.missed += 1
            continue
        distance = np.abs(np.cos(angle) * x + np.sin(angle) * y - offset)
        near = distance <= reach_px
        bound = _bound_px(truth, x[near], y[near], np.sqrt(variance[near]))
        errors.add(fit.optical_sigma_px, fit.optical_sigma_err_px, sigma_px, bound)
    return errors


def _noise(record: Recorder, edges: int) -> None:
    header = "  sigma   SNR  bias %  scatter %  rms/bound  in 95 %  missed"
    record.say(f"\noptical width of {edges} edges a line, found and fitted\n{header}")
    squares: list[float] = []
    for sigma_px in (0.5, 0.8, 1.5):
        for snr in (100.0, 30.0, 12.0):
            errors = _noisy_cell(sigma_px, snr, edges)
            squares += errors.scaled
            name = f"error of sigma over its bound, {sigma_px} px, SNR {snr:g}"
            record.figure(name, errors.rms, "of the bound")
            record.say(f"  {sigma_px:5.2f} {snr:5.0f}{_line(errors)}")
    record.say(f"  over all cells: rms/bound {np.sqrt(np.mean(np.square(squares))):.3f}")
    record.say("shot noise, 15 times the variance on the bright side, line known")
    record.say(f"  {0.8:5.2f} {30:5.0f}{_line(_noisy_cell(0.8, 30.0, edges, is_shot=True))}")
    record.say("faint and short")
    record.say(f"  {0.8:5.2f} {6:5.0f}{_line(_noisy_cell(0.8, 6.0, edges))}")
    record.say(f"  {0.8:5.2f} {30:5.0f}{_line(_noisy_cell(0.8, 30.0, edges, length_px=20))}  20 px")


def _tilted_psf(record: Recorder, draws: int) -> None:
    """Covariance of a PSF with rho 0.35 behind the pixel, from 24 edges of 100 px."""
    sigma_x, sigma_y, rho, snr, count = 0.9, 0.7, 0.35, 30.0, 24
    truth = np.array([sigma_x, sigma_y, rho])
    rng = np.random.default_rng(35)
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX] - (SIDE_PX - 1) / 2
    noise_dn = CONTRAST_DN / snr
    scaled, held = [], np.zeros(3)
    for _ in range(draws):
        angles = np.pi * (np.arange(count) + rng.uniform(0, 1, count)) / count
        rows, widths, errors, directions = [], [], [], []
        for angle in angles:
            c, s = np.cos(angle), np.sin(angle)
            variance = (c * sigma_x) ** 2 + (s * sigma_y) ** 2 + 2 * c * s * rho * sigma_x * sigma_y
            width = sqrt(variance)
            edge = np.array([angle, rng.uniform(-10, 10), 0.0, np.log(width), LOW_DN, HIGH_DN])
            image = exact_edge(edge, x, y) + rng.normal(0, noise_dn, x.shape)
            fit = _only_fit(image)
            if fit is None or fit.optical_sigma_px is None or fit.optical_sigma_err_px is None:
                continue
            near = np.abs(c * x + s * y - edge[1]) <= 6 * hypot(width, PIXEL_SIGMA_PX) + 3
            bound = _bound_px(edge, x[near], y[near], np.full(near.sum(), noise_dn))
            # Derivative of the width by sigma_x, sigma_y and rho.
            rows.append(
                np.array(
                    [
                        c * c * sigma_x + c * s * rho * sigma_y,
                        s * s * sigma_y + c * s * rho * sigma_x,
                        c * s * sigma_x * sigma_y,
                    ]
                )
                / width
                / bound
            )
            widths.append(fit.optical_sigma_px)
            errors.append(fit.optical_sigma_err_px)
            directions.append(fit.angle_deg)
        design = np.array(rows)
        bounds = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
        found = fit_covariance(np.array(directions), np.array(widths), np.array(errors))
        estimates = (found.sigma_x_px, found.sigma_y_px, found.rho)
        values = np.array([e.value if e else np.nan for e in estimates])
        held += [bool(e and e.low <= t <= e.high) for e, t in zip(estimates, truth, strict=True)]
        scaled.append((values - truth) / bounds)
    rms = np.sqrt(np.mean(np.square(scaled), axis=0))
    record.say(f"\ntilted PSF, {count} edges of {SIDE_PX} px at SNR {snr:.0f}, {draws} draws")
    for name, ratio, inside in zip(("sigma_x", "sigma_y", "rho"), rms, held, strict=True):
        record.figure(f"error of {name} over its bound, tilted PSF", ratio, "of the bound")
        record.say(
            f"  {name:8s} rms/bound {ratio:.3f}, in the 95 % interval {100 * inside / draws:.1f} %"
        )


@benchmark("numpy", "scipy", "numba")
def main(
    record: Recorder,
    *,
    edges: Annotated[int | None, "edges in each noise cell, 2000 by default"] = None,
    draws: Annotated[int | None, "draws of the tilted PSF, 200 by default"] = None,
) -> None:
    _noise_free(record)
    _noise(record, edges or record.pick(2000, 100))
    _tilted_psf(record, draws or record.pick(200, 10))
