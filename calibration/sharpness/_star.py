"""Contrast by frequency from a Siemens star (s-SFR of ISO 12233), found in the photograph.

All edges of a star point at its centre: lines along them are counted where they meet, by direction,
so that a few long edges elsewhere do not count as one. Around the centre, the angular period that
rings share is that of the star, and the phase that sectors share says where its centre is. In each
ring of each of eight sectors (ISO 12233:2024), a wave of that period is fitted; the part
in phase with the star is the contrast, in which noise cancels.

The contrast of the target itself is not known. The curve is 1 at frequency 0: by edges of the same
photograph, if it shows any, else by what one smooth curve through all rings extrapolates to. Where
that curve falls to a level, all rings say together.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import hypot, pi
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyroots, polyval
from scipy.ndimage import gaussian_filter, map_coordinates

from simulation.arrays import BoolArray, FloatArray

SECTORS: Final = 8
_LARGEST_SIDE_PX = 1400
_CELL_PX = 4
_DIRECTIONS = 8
_STRONGEST = 40_000
_GRADIENT_SIGMAS = 4.0
_CYCLES = (10, 300)
_ANGLES = 4096
_SHARE = 0.35  # of a ring's power at the star's period
_FEWEST_RINGS = 12
_RING_SHARE = 0.02
_FEWEST_PIXELS = 24
_RING_PIXELS = 30  # in a sector, about
_FREQ_MOST = 0.5
_RIM_PERIODS = 1.2  # of the finest one seen: three sigma of a Gaussian blur
_LOW = (0.85, 0.7, 0.55)  # of the largest contrast: from there up, the curve is extrapolated
_LOW_RANGE = 2.0  # ratio of the frequencies, of which the first of these that has it is taken
_OTHER_SHARE = 0.5
_FEWEST_LOW = 5
_OF_EDGES = 3e-3  # relative
_SEEN_SIGMAS = 3.0
_POWERS = ((0, 1, 2), (0, 1, 2, 4), (0, 1, 2, 3, 4))
_BETTER = 9.0  # of chi-squared, a term
_LEAST_CONTRAST = 0.02
_STEPS, _STEP_SIGMAS = 40, 1e-3


EdgeMtf = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True, kw_only=True)
class StarPlace:
    """Where a star is: its centre, cycles around it, and the radii between which it was seen."""

    x_px: float
    y_px: float
    cycles: int
    inner_px: float
    outer_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarSfr:
    """Contrast by frequency of a star.

    ``mtf`` and ``mtf_err`` have a row for each sector, whose middles are at ``sector_deg`` from +x
    on, y down: the waves of a sector lie across that direction. NaN where a sector is not in the
    frame. ``scaled_by`` says what 1 at frequency 0 is by, ``scale_err`` is its relative error;
    ``smooth`` is the curve through the mean of the sectors.
    """

    place: StarPlace
    freq_cy_per_px: FloatArray
    mtf: FloatArray
    mtf_err: FloatArray
    sector_deg: tuple[float, ...]
    scale_err: float
    scaled_by: Literal["edges", "extrapolation"]
    smooth: "SmoothContrast"


def find_star(image_dn: FloatArray) -> StarPlace | None:
    """Find a Siemens star; None if there is none."""
    start = _meeting_point(image_dn)
    if start is None:
        return None
    centre, seen = start, _rings(image_dn, start)
    for _ in range(3):
        if seen is None:
            return None
        centre = _centred(image_dn, centre, *seen)
        seen = _rings(image_dn, centre)
    if seen is None:
        return None
    cycles, inner, outer = seen
    return StarPlace(x_px=centre[0], y_px=centre[1], cycles=cycles, inner_px=inner, outer_px=outer)


def _meeting_point(image_dn: FloatArray) -> tuple[float, float] | None:
    """Where lines of all directions along edges meet."""
    factor = max(1, -(-max(image_dn.shape) // _LARGEST_SIDE_PX))
    rows, cols = (size // factor for size in image_dn.shape)
    small = image_dn[: rows * factor, : cols * factor]
    small = small.reshape(rows, factor, cols, factor).mean(axis=(1, 3))
    smooth = gaussian_filter(small, 1.0)
    down, right = np.gradient(smooth)
    size = np.hypot(right, down)
    noise = float(np.median(np.abs(small - smooth))) / 0.6745
    strong = np.flatnonzero(size.ravel() > _GRADIENT_SIGMAS * noise * 0.28)
    if strong.size < 200:
        return None
    strong = strong[np.argsort(size.ravel()[strong])[::-1][:_STRONGEST]]
    y, x = np.divmod(strong, cols)
    along_x, along_y = -down.ravel()[strong], right.ravel()[strong]
    length = np.hypot(along_x, along_y)
    along_x, along_y = along_x / length, along_y / length
    bins = (np.floor((np.arctan2(along_y, along_x) % pi) / pi * _DIRECTIONS)).astype(np.int64)
    grid = (rows // _CELL_PX + 1, cols // _CELL_PX + 1)
    votes = np.zeros((_DIRECTIONS, *grid))
    reach = int(np.hypot(rows, cols) / 2)
    for step in range(-reach, reach + 1, _CELL_PX):
        to_x, to_y = (x + step * along_x) / _CELL_PX, (y + step * along_y) / _CELL_PX
        inside = (to_x >= 0) & (to_y >= 0) & (to_x < grid[1] - 1) & (to_y < grid[0] - 1)
        place = (bins[inside], to_y[inside].astype(np.int64), to_x[inside].astype(np.int64))
        np.add.at(votes, place, 1.0)
    met = np.sort(gaussian_filter(votes, (0, 0.7, 0.7)), axis=0)[2]  # all directions but two
    best_y, best_x = np.unravel_index(int(np.argmax(met)), met.shape)
    at_x, at_y = (best_x + 0.5) * _CELL_PX, (best_y + 0.5) * _CELL_PX
    for _ in range(6):  # least squares of the distances of lines, without those that pass by
        beside = (at_x - x) * along_y - (at_y - y) * along_x
        near = np.abs(beside) < 2 * _CELL_PX
        if near.sum() < 50:
            return None
        normal = np.column_stack([along_y[near], -along_x[near]])
        place_of = along_y[near] * x[near] - along_x[near] * y[near]
        at_x, at_y = np.linalg.lstsq(normal, place_of, rcond=None)[0].tolist()
    return (at_x + 0.5) * factor - 0.5, (at_y + 0.5) * factor - 0.5


def _rings(image_dn: FloatArray, centre: tuple[float, float]) -> tuple[int, float, float] | None:
    """Cycles around the centre, and the radii of the rings that show them."""
    rows, cols = image_dn.shape
    most = max(min(centre[0], cols - 1 - centre[0], centre[1], rows - 1 - centre[1]), 0.0)
    radii = np.arange(6.0, most, 1.0)
    if radii.size < _FEWEST_RINGS:
        return None
    turn = np.arange(_ANGLES) * 2 * pi / _ANGLES
    x = centre[0] + radii[:, None] * np.cos(turn)
    y = centre[1] + radii[:, None] * np.sin(turn)
    power = np.abs(np.fft.rfft(map_coordinates(image_dn, [y, x], order=1), axis=1)) ** 2
    power[:, :3] = 0.0  # light that changes over the star
    total = np.maximum(power.sum(axis=1), 1e-300)
    found = _CYCLES[0] + np.argmax(power[:, _CYCLES[0] : _CYCLES[1]], axis=1)
    share = power[np.arange(radii.size), found] / total
    sure = share > _SHARE
    if sure.sum() < _FEWEST_RINGS:
        return None
    cycles = int(np.bincount(found[sure]).argmax())
    of_star = (found == cycles) & sure
    if of_star.sum() < max(_FEWEST_RINGS, sure.sum() // 2):
        return None
    shown = radii[of_star]
    return cycles, float(shown.min()), float(np.percentile(shown, 99)) - 2.0


def _centred(
    image_dn: FloatArray, centre: tuple[float, float], cycles: int, inner: float, outer: float
) -> tuple[float, float]:
    """The centre about which all sectors have one phase."""
    design, phases, weights = [], [], []
    base: complex = 0.0
    for low in np.arange(max(inner, 0.4 * outer), outer - 4, 4.0):
        for number in range(SECTORS):
            fit = _wave(image_dn, centre, cycles, (float(low), float(low) + 4.0), number)
            if fit is None or not fit.amplitude:
                continue
            turn = (number + 0.5) * 2 * pi / SECTORS
            design.append(cycles / (low + 2) * np.array([np.sin(turn), -np.cos(turn)]))
            phases.append(fit.amplitude)
            weights.append(abs(fit.amplitude) / fit.err)
            base += fit.amplitude / abs(fit.amplitude) * weights[-1]
    if len(phases) < 3 * SECTORS:
        return centre
    left = np.angle(np.array(phases) / base)
    weight = np.array(weights)
    both = np.column_stack([np.array(design), np.ones(left.size)])
    moved = np.linalg.lstsq(weight[:, None] * both, weight * left, rcond=None)[0]
    return centre[0] + float(moved[0]), centre[1] + float(moved[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wave:
    """A wave fitted to a part of a ring: its complex amplitude over the mean, and its error.

    ``freq_cy_per_px`` is the mean over the pixels.
    """

    freq_cy_per_px: float
    amplitude: complex
    err: float


def _wave(
    image_dn: FloatArray,
    centre: tuple[float, float],
    cycles: int,
    radii: tuple[float, float],
    sector: int,
) -> _Wave | None:
    """Fit a wave, and its third harmonic as of square spokes, to the pixels of a ring's sector."""
    rows, cols = image_dn.shape
    middle = (sector + 0.5) * 2 * pi / SECTORS
    half = pi / SECTORS
    ends = middle + np.linspace(-half, half, 9)
    x_ends = centre[0] + np.outer(radii, np.cos(ends))
    y_ends = centre[1] + np.outer(radii, np.sin(ends))
    left, right = max(int(x_ends.min()), 0), min(int(x_ends.max()) + 2, cols)
    top, bottom = max(int(y_ends.min()), 0), min(int(y_ends.max()) + 2, rows)
    if left >= right or top >= bottom:
        return None
    y, x = np.mgrid[top:bottom, left:right]
    away_x, away_y = x - centre[0], y - centre[1]
    radius, turn = np.hypot(away_x, away_y), np.arctan2(away_y, away_x)
    near = np.abs((turn - middle + pi) % (2 * pi) - pi) <= half
    inside = near & (radius >= radii[0]) & (radius < radii[1])
    if inside.sum() < _FEWEST_PIXELS:
        return None
    levels = image_dn[top:bottom, left:right][inside].astype(np.float64)
    angle, size = cycles * turn[inside], radius[inside]
    terms = [np.ones(size.size), np.cos(angle), np.sin(angle), (turn[inside] - middle) % (2 * pi)]
    terms[3] = (terms[3] + pi) % (2 * pi) - pi
    if 3 * cycles / (2 * pi * size.mean()) < 0.8 and size.size > 2 * _FEWEST_PIXELS:
        terms += [np.cos(3 * angle), np.sin(3 * angle)]
    design = np.column_stack(terms)
    normal = design.T @ design
    try:
        covariance = np.linalg.inv(normal)
    except np.linalg.LinAlgError:
        return None
    found = covariance @ design.T @ levels
    residual = levels - design @ found
    variance = float(residual @ residual) / max(size.size - design.shape[1], 1)
    mean = float(found[0])
    if not mean > 0:
        return None
    err = float(np.sqrt(variance * 0.5 * (covariance[1, 1] + covariance[2, 2]))) / mean
    return _Wave(
        freq_cy_per_px=cycles / (2 * pi) * float(np.mean(1 / size)),
        amplitude=complex(found[1], -found[2]) / mean,
        err=max(err, 1e-9),
    )


def measure_star(
    image_dn: FloatArray, place: StarPlace, edge_mtf: EdgeMtf | None
) -> StarSfr | None:
    """Measure a star that was found; None if it shows no contrast.

    Parameters
    ----------
    image_dn
        Levels linear in light, shape ``(rows, cols)``.
    place
        Where the star is.
    edge_mtf
        Contrast by frequency of edges of the same photograph, which say what 1 is, and its standard
        error; None without.
    """
    radii = _ring_radii(place)
    centre = (place.x_px, place.y_px)
    rings = [[_wave(image_dn, centre, place.cycles, one, k) for k in range(SECTORS)]
             for one in radii]  # fmt: skip
    waves = [ring for ring in rings if any(ring)]
    if not waves:
        return None
    freq = np.array([np.mean([one.freq_cy_per_px for one in ring if one]) for ring in waves])
    amplitude = np.array([[np.nan if w is None else w.amplitude for w in row] for row in waves])
    errs = np.array([[np.nan if w is None else w.err for w in row] for row in waves])
    contrast = np.column_stack(
        [_in_phase(amplitude[:, k], errs[:, k], freq) for k in range(SECTORS)]
    )
    contrast = _at_middles(contrast)
    mean, mean_err = mean_of_sectors(contrast.T, errs.T)
    known = np.isfinite(mean)
    smooth = _smooth_of(freq[known], mean[known], mean_err[known], edge_mtf)
    if smooth is None:
        return None
    scale = smooth.at_zero
    turns = [(k + 0.5) * 360 / SECTORS for k in range(SECTORS)]
    return StarSfr(
        place=place,
        freq_cy_per_px=freq,
        mtf=(contrast / scale.value).T,
        mtf_err=(errs / scale.value).T,
        sector_deg=tuple(turns),
        scale_err=scale.relative_err,
        scaled_by="extrapolation" if edge_mtf is None else "edges",
        smooth=smooth,
    )


def _ring_radii(place: StarPlace) -> list[tuple[float, float]]:
    """Rings from inside the blur of the rim inwards, to the frequency of the sampling's limit."""
    least = place.cycles / (2 * pi * _FREQ_MOST)
    finest_px = 2 * pi * place.inner_px / place.cycles
    found, high = [], place.outer_px - _RIM_PERIODS * finest_px
    while high > least:
        low = high - max(1.0, _RING_SHARE * high, _RING_PIXELS / (2 * pi / SECTORS * high))
        found.append((max(low, least), high))
        high = low
    return [one for one in found if one[1] - one[0] > 0.5]


def _in_phase(amplitude: FloatArray, errs: FloatArray, freq: FloatArray) -> FloatArray:
    """The part in phase with the star, whose phase in a sector changes slowly with frequency."""
    known = np.isfinite(errs)
    found = np.full(freq.size, np.nan)
    strong = known & (np.abs(np.nan_to_num(amplitude)) > 2 * _SEEN_SIGMAS * np.nan_to_num(errs))
    if strong.sum() < 4:
        return found
    phase = np.unwrap(np.angle(amplitude[strong]))
    weight = np.abs(amplitude[strong]) / errs[strong]
    design = np.column_stack([np.ones(phase.size), freq[strong], 1 / freq[strong]])
    fit = np.linalg.lstsq(weight[:, None] * design, weight * phase, rcond=None)[0]
    turn = fit[0] + fit[1] * freq[known] + fit[2] / freq[known]
    found[known] = (amplitude[known] * np.exp(-1j * turn)).real
    return found


def _at_middles(contrast: FloatArray) -> FloatArray:
    """Contrast at the middle of each ring, of the means over rings that follow one another.

    A mean over a ring exceeds the middle by a 24th of the second difference of such means.
    """
    second = contrast[:-2] - 2 * contrast[1:-1] + contrast[2:]
    second = np.concatenate([second[:1], second, second[-1:]]) if len(second) else second
    return contrast - np.nan_to_num(second) / 24 if len(second) else contrast


def mean_of_sectors(mtf: FloatArray, err: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean over the sectors in which a frequency was seen; NaN where fewer than half are.

    Sectors weigh the same, whatever their errors: contrasts differ by direction.
    """
    seen = np.isfinite(mtf)
    count = seen.sum(axis=0)
    enough = 2 * count >= len(mtf)
    mean = np.where(seen, mtf, 0.0).sum(axis=0) / np.maximum(count, 1)
    spread = np.sqrt((np.where(seen, err, 0.0) ** 2).sum(axis=0)) / np.maximum(count, 1)
    return np.where(enough, mean, np.nan), np.where(enough, spread, np.nan)


def _lowest(freq: FloatArray, mean: FloatArray) -> BoolArray:
    """The frequencies, from the lowest on, that say what the contrast is at 0."""
    low = np.zeros(freq.size, np.bool_)
    for share in _LOW:
        low = mean > share * mean[:3].mean()
        low[np.argmin(low) if not low.all() else low.size :] = False
        if low.sum() >= _FEWEST_LOW and freq[low].max() > _LOW_RANGE * freq[low].min():
            break
    return low


class ContrastAtZero(NamedTuple):
    """Contrast of a target at frequency 0, and its relative error."""

    value: float
    relative_err: float


def contrast_at_zero(freq: FloatArray, mean: FloatArray, errs: FloatArray) -> ContrastAtZero | None:
    """Contrast of a target at frequency 0, by its lowest frequencies."""
    low = _lowest(freq, mean)
    if low.sum() < _FEWEST_LOW:
        return None
    weight = mean[low] / errs[low]
    values, noise = [], []
    # The transfer of a lens that is limited by diffraction falls from 0 on like a line, not like
    # a parabola, and that of scattered light like neither.
    for powers in ((0, 2, 4), (0, 1, 2)):
        design = np.column_stack([freq[low] ** power for power in powers]) * weight[:, None]
        covariance = np.linalg.pinv(design.T @ design)
        fit = covariance @ design.T @ (weight * np.log(mean[low]))
        values.append(float(fit[0]))
        noise.append(float(np.sqrt(covariance[0, 0])))
    err = float(np.hypot(noise[-1], _OTHER_SHARE * abs(values[1] - values[0])))
    return ContrastAtZero(float(np.exp(values[1])), err)


def _by_edges(
    freq: FloatArray, mean: FloatArray, errs: FloatArray, edge_mtf: EdgeMtf
) -> ContrastAtZero | None:
    """Contrast of a target at frequency 0, by edges at its lowest frequencies."""
    low = _lowest(freq, mean)
    if low.sum() < _FEWEST_LOW:
        return None
    known, known_err = edge_mtf(freq[low])
    ratio = float(np.sum(mean[low] * known) / np.sum(known**2))
    by_noise = float(np.sqrt(np.sum((errs[low] * known) ** 2)) / np.sum(known**2)) / ratio
    # One edge is wrong at all frequencies alike.
    by_edges = float(np.sum(known_err * known) / np.sum(known**2))
    return ContrastAtZero(ratio, float(np.linalg.norm([by_noise, by_edges, _OF_EDGES])))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothContrast:
    """Contrast whose logarithm is a polynomial of the frequency, with its covariance.

    A lens that is limited by diffraction falls from frequency 0 on like a line, a Gaussian like a
    parabola: the polynomial has both terms. ``least`` and ``most`` are the frequencies between
    which it was measured. ``richer`` is a polynomial of more terms that fits as well: of what it
    says otherwise, a half counts as error.
    """

    powers: tuple[int, ...]
    terms: FloatArray
    covariance: FloatArray
    least: float
    most: float
    richer: "SmoothContrast | None" = None

    @property
    def at_zero(self) -> ContrastAtZero:
        """Contrast at frequency 0."""
        err = float(np.sqrt(self.covariance[0, 0]))
        if self.richer is not None:
            err = hypot(err, _OTHER_SHARE * float(self.richer.terms[0] - self.terms[0]))
        return ContrastAtZero(float(np.exp(self.terms[0])), err)

    def crossing(self, level: float) -> tuple[float, float] | None:
        """Where the contrast falls to a share of that at 0, in cy/px, with its standard error."""
        known = self._crossing(level)
        other = None if self.richer is None else self.richer._crossing(level)
        if known is None or other is None:
            return known
        return known[0], hypot(known[1], _OTHER_SHARE * (other[0] - known[0]))

    def _crossing(self, level: float) -> tuple[float, float] | None:
        away = np.zeros(max(self.powers) + 1)
        away[list(self.powers)] = self.terms
        away[0] = -np.log(level)
        inside = [
            float(one.real)
            for one in polyroots(away)
            if abs(one.imag) < 1e-9 and self.least <= one.real <= self.most
        ]
        if not inside:
            return None
        found = min(inside)
        moved = np.array([0.0 if power == 0 else found**power for power in self.powers])
        err = float(np.sqrt(moved @ self.covariance @ moved))
        return found, err / abs(float(polyval(found, polyder(away))))


def _smooth_of(
    freq: FloatArray, mean: FloatArray, errs: FloatArray, edge_mtf: EdgeMtf | None
) -> SmoothContrast | None:
    """Fit rings with the fewest terms than which no more are better by more than chance."""
    if freq.size < _FEWEST_RINGS:
        return None
    zero = None if edge_mtf is None else _by_edges(freq, mean, errs, edge_mtf)
    if zero is None and edge_mtf is not None:
        return None
    rings = freq, mean, errs
    fits = [one for powers in _POWERS if (one := _fitted(powers, rings, zero)) is not None]
    if not fits:
        return None
    excess = max(1.0, min(chi2 / (freq.size - len(fit.powers)) for fit, chi2 in fits))
    chosen = 0
    for number, (fit, chi2) in enumerate(fits):
        best, least = fits[chosen]
        if chi2 < least - _BETTER * excess * (len(fit.powers) - len(best.powers)):
            chosen = number
    best = fits[chosen][0]
    richer = fits[chosen + 1][0] if chosen + 1 < len(fits) else None
    return replace(best, covariance=best.covariance * excess, richer=richer)


def _fitted(
    powers: tuple[int, ...],
    rings: tuple[FloatArray, FloatArray, FloatArray],
    zero: ContrastAtZero | None,
) -> tuple[SmoothContrast, float] | None:
    """One polynomial, by Gauss and Newton, and its chi-squared; None if it does not converge.

    The logarithm of noisy contrasts would be biased. ``zero`` counts as one more ring.
    """
    freq, mean, errs = rings
    basis = freq[:, None] ** np.array(powers)
    known, wanted = np.empty((0, len(powers))), np.empty(0)
    if zero is not None:
        known = np.eye(1, len(powers)) / zero.relative_err
        wanted = np.array([np.log(zero.value) / zero.relative_err])
    model = np.maximum(mean, _LEAST_CONTRAST)
    terms = np.linalg.lstsq(basis * (model / errs)[:, None], np.log(model) * model / errs)[0]
    for _ in range(_STEPS):
        model = np.exp(np.minimum(basis @ terms, 1.0))
        design = np.concatenate([basis * (model / errs)[:, None], known])
        left = np.concatenate([(mean - model) / errs, wanted - known @ terms])
        step = np.linalg.lstsq(design, left)[0]
        terms = terms + step
        if np.abs(design @ step).max() < _STEP_SIGMAS:
            curve = SmoothContrast(
                powers=powers,
                terms=terms,
                covariance=np.linalg.pinv(design.T @ design),
                least=float(freq.min()),
                most=float(freq.max()),
            )
            return curve, float(left @ left)
    return None
