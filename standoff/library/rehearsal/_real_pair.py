"""The demo on two real photographs: what changed, and what could have been missed."""

from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from acquisition.files import make_folder, write_file
from acquisition.photographs import Encoding
from analysis.changes import describe_limit
from analysis.reports import (
    ReportSection,
    changes_section,
    compared_pictures,
    count_text,
    limit_figure,
    limit_section,
    view_figures,
)
from simulation.arrays import FloatArray
from standoff.library.call import Call
from standoff.library.changes import ComparedPhotographs, find_changes
from standoff.library.limit_options import DetectionLimitOptions
from standoff.library.photographs import example_photographs

DEMO_PHOTOGRAPHS = _BEFORE, _AFTER = "photographs/before.png", "photographs/after.png"
"""Files below the demo's folder: the nearer photograph, and the further one with the spots."""

_SPOT_SIGMA_PX = 2.0
_SPOT_DN = 40.0
_PLACES = (("in the dark sky", 120, 185), ("on the bright temple", 395, 215))
_WHITE_DN = 255.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PaintedSpot:
    """A Gaussian spot that was added to a photograph, and whether it was found there.

    ``needed_dn`` is the amplitude that is found 95 times of 100 at this place; infinite where
    nothing is compared.
    """

    where: str
    x_px: int
    y_px: int
    amplitude_dn: float
    sigma_px: float
    needed_dn: float
    is_found: bool

    @property
    def text(self) -> str:
        """The spot in words."""
        state = "found" if self.is_found else "missed"
        return f"{self.where} it is {state} ({self.needed_dn:.2g} DN are needed there)"


@dataclass(frozen=True, kw_only=True)
class RealPair:
    """Two photographs of one scene, compared as they are and with spots added to the later one."""

    unchanged: ComparedPhotographs
    painted: ComparedPhotographs
    spots: tuple[PaintedSpot, ...]

    @property
    def sentence(self) -> str:
        """What was found and missed, in one line."""
        as_they_are = count_text(len(self.unchanged.summary.changes))
        spots = "; ".join(spot.text for spot in self.spots)
        return (
            f"two real photographs between which nothing changed: {as_they_are}; a spot of "
            f"{_SPOT_DN:g} DN painted into the later one: {spots}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return what was found as ``standoff demo --json`` prints it."""
        return {
            "changes_unpainted": len(self.unchanged.summary.changes),
            "changes_painted": len(self.painted.summary.changes),
            "spots": [
                {
                    "x_px": spot.x_px,
                    "y_px": spot.y_px,
                    "sigma_px": spot.sigma_px,
                    "amplitude_dn": spot.amplitude_dn,
                    "needed_dn": spot.needed_dn if np.isfinite(spot.needed_dn) else None,
                    "is_found": spot.is_found,
                }
                for spot in self.spots
            ],
        }

    def sections(self) -> tuple[ReportSection, ReportSection]:
        """Return what changed and what could have been missed, for a report."""
        found, limit = self.painted, self.unchanged.summary.detection_limit
        assert limit is not None
        rows, cols = found.followup_dn.shape
        pictures = compared_pictures(found.reference.grey_dn, found, None, found.colours)
        views = view_figures(pictures, found.summary.changes, (cols, rows), found.summary.moved)
        changes = changes_section(found.summary, views)
        missed = limit_section(limit, limit_figure(self.unchanged))
        return (
            replace(
                changes,
                title="From two distances: what changed",
                text=(*self._story(), *changes.text),
            ),
            replace(
                missed,
                title="From two distances: what could have been missed",
                text=(*self._limits(), *missed.text),
            ),
        )

    def _story(self) -> tuple[str, ...]:
        count = count_text(len(self.unchanged.summary.changes))
        places = " and ".join(f"({spot.x_px}, {spot.y_px})" for spot in self.spots)
        spots = "; ".join(spot.text for spot in self.spots)
        return (
            "A printed postcard, photographed by a phone from two distances (City100, Chen et al., "
            "CVPR 2019, MIT licence; the further photograph as its publishers scaled it onto the "
            f"nearer one's pixels). Nothing changed between them; standoff lists {count}.",
            "Below, the later photograph has two spots that are not real: the same soft spot, of "
            f"{_SPOT_DN:g} DN and a sigma of {_SPOT_SIGMA_PX:g} px, was painted in for this demo "
            f"at x, y = {places}. {spots[0].upper()}{spots[1:]}.",
        )

    def _limits(self) -> tuple[str, ...]:
        summary = self.unchanged.summary
        said = describe_limit(summary)
        limit = () if said is None else (f"{said[0].upper()}{said[1:]}.",)
        return (
            "For the photographs without the painted spots: where no change is listed, there may "
            "still be one with an amplitude below these.",
            *limit,
            *(f"Warning: {warning}." for warning in summary.warnings),
        )


def compare_real_pair(call: Call, out: Path) -> RealPair:
    """Write the photographs below ``out``, and compare them without and with the painted spots."""
    pair = example_photographs()
    before, after = out / _BEFORE, out / _AFTER
    make_folder(before.parent)
    write_file(before, pair.nearer.read_bytes())
    write_file(after, _painted_png(pair.further))
    limit = DetectionLimitOptions(spot_sigma_px=_SPOT_SIGMA_PX)
    with call.bar("comparing real photographs", 2) as advance_to:
        unchanged = find_changes(before, pair.further, limit=limit)
        advance_to(1)
        painted = find_changes(before, after, limit=limit)
        advance_to(2)
    spots = tuple(_judged(where, x, y, unchanged, painted) for where, x, y in _PLACES)
    return RealPair(unchanged=unchanged, painted=painted, spots=spots)


def _judged(
    where: str, x_px: int, y_px: int, unchanged: ComparedPhotographs, painted: ComparedPhotographs
) -> PaintedSpot:
    return PaintedSpot(
        where=where,
        x_px=x_px,
        y_px=y_px,
        amplitude_dn=_SPOT_DN,
        sigma_px=_SPOT_SIGMA_PX,
        needed_dn=float(unchanged.limit_dn[y_px, x_px]),
        is_found=any(
            hypot(change.x_px - x_px, change.y_px - y_px) < _SPOT_SIGMA_PX
            for change in painted.summary.changes
        ),
    )


def _painted_png(path: Path) -> bytes:
    """The photograph with a spot at each of the places, added to its linear levels."""
    stored = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert stored is not None
    encoding = Encoding(name="srgb")
    linear = encoding.decode(stored, _WHITE_DN) + _spots(stored.shape[:2])[..., np.newaxis]
    levels = encoding.encode(np.minimum(linear, _WHITE_DN), _WHITE_DN)
    done, data = cv2.imencode(".png", np.rint(levels).astype(np.uint8))
    assert done
    return data.tobytes()


def _spots(shape: tuple[int, ...]) -> FloatArray:
    y, x = np.indices(shape)
    spots = np.zeros(shape)
    for _, x_px, y_px in _PLACES:
        squared_px2 = (x - x_px) ** 2 + (y - y_px) ** 2
        spots += _SPOT_DN * np.exp(-squared_px2 / (2 * _SPOT_SIGMA_PX**2))
    return spots
