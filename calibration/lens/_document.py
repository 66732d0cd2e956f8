"""lens.json: the figures of a lens and its camera, as a page shows them and other programs read."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

from pydantic import Field

from acquisition.dataframe import dataframe
from acquisition.files import Provenance, StoredModel
from calibration.documents import json_object
from calibration.edges import AxisTransfer, EdgeMeasurement, mean_transfer
from calibration.estimate import Estimate
from calibration.lens._capacity import CapacityFigures
from calibration.lens._lateral_colour import LateralColourField
from calibration.lens._targets import StarFigures
from calibration.lens._texture import TextureFigures
from calibration.lens._through_focus import FocusPoint, ThroughFocus
from calibration.noise import EmvaSheet, NoiseCalibration, NoiseMeasurement
from calibration.psf import PsfCalibration
from calibration.sharpness import (
    FIGURE_NAMES,
    EdgeFigures,
    MeasuredValue,
    Sharpening,
    SharpnessVerdict,
    edge_figures,
    lp_per_mm,
    lw_per_ph,
    median_figures,
    sharpening_of,
)
from simulation.by_value import ByValue
from simulation.notebook import Shown, html_table

if TYPE_CHECKING:
    from pandas import DataFrame

LENS_SCHEMA: Final = "standoff.lens/1"

Colour = Literal["grey", "luma", "red", "green", "blue"]


class ColourFigures(StoredModel):
    """Medians over the edges of one colour, which may be grey or the luma (Y) of all.

    Over- and undershoot are those of the median edge profile. ``sfr`` is the median contrast by
    frequency; None without an e-SFR.
    """

    colour: Colour
    edges: int
    median: EdgeFigures
    sfr: AxisTransfer | None = None


class EdgeOfColour(StoredModel):
    """One edge in one colour."""

    colour: Colour
    image: str
    x_px: float
    y_px: float
    angle_deg: float
    length_px: float
    figures: EdgeFigures


class SharpeningFigures(StoredModel):
    """Over- and undershoot of the median edge profile, over the contrast, and what follows."""

    overshoot: MeasuredValue
    undershoot: MeasuredValue
    is_sharpened: bool
    sentence: str

    @classmethod
    def of(cls, found: Sharpening) -> "SharpeningFigures":
        """Return what was found as part of the document."""
        return cls(**_beyond(found), is_sharpened=found.is_found, sentence=found.sentence)


def _beyond(found: Sharpening) -> dict[str, Any]:
    """Over- and undershoot as parts of the document."""
    return {
        name: MeasuredValue(value=one.value, err=one.err)
        for name, one in (("overshoot", found.overshoot), ("undershoot", found.undershoot))
    }


class LateralShift(StoredModel):
    """The largest shift of a colour from green across an edge, positive away from the centre."""

    colour: Literal["red", "blue"]
    shift_px: MeasuredValue
    x_px: float
    y_px: float


class DataSheetFigure(StoredModel):
    """A figure of the data sheet of EMVA 1288; ``err`` is a standard error, None if not known.

    What follows from saturation has none if no flat reached it.
    """

    figure: str
    symbol: str
    value: float
    err: float | None = None
    unit: str


class LensMeasurement(Shown, ByValue, StoredModel, arbitrary_types_allowed=True):
    """Sharpness, noise and both together of a lens and camera: the content of a lens.json.

    Parameters
    ----------
    colours, edges
        Medians of each colour, and the figures of every edge in each.
    sharpening
        Over- and undershoot; None where no edge has an e-SFR.
    lateral_colour
        The largest lateral chromatic aberration of red and of blue; empty without colours.
    lateral_fields
        Red and blue over the field; empty without colours or with fewer than eight edges.
    capacity
        Quanta, detection, information; None where ``notes`` say why.
    noise
        The noise calibration; None without darks and flats.
    emva
        The data sheet of EMVA 1288; empty without darks and flats.
    stars
        What Siemens stars in the photographs tell; empty without any.
    textures
        What dead leaves in the photographs tell; empty without any.
    through_focus
        Best focus over the field and depth of field; None of photographs at fewer than five focus
        positions or heights, or without a best focus between them.
    verdict
        Comparison with a limits file.
    psf, noise_measurement
        What the figures are from; not stored in a file.
    notes
        Remarks; not stored in a file.
    """

    schema_name: Literal["standoff.lens/1"] = Field(default=LENS_SCHEMA, alias="schema", repr=False)
    labels: dict[str, str] | None = None
    picture_width_px: int | None = None
    picture_height_px: int | None = None
    pixel_pitch_um: float | None = None
    colours: tuple[ColourFigures, ...]
    sharpening: SharpeningFigures | None = None
    lateral_colour: tuple[LateralShift, ...] = ()
    lateral_fields: tuple[LateralColourField, ...] = Field(default=(), repr=False)
    capacity: CapacityFigures | None = None
    noise: NoiseCalibration | None = None
    emva: tuple[DataSheetFigure, ...] = Field(default=(), repr=False)
    stars: tuple[StarFigures, ...] = Field(default=(), repr=False)
    textures: tuple[TextureFigures, ...] = Field(default=(), repr=False)
    through_focus: ThroughFocus | None = None
    verdict: SharpnessVerdict | None = None
    edges: tuple[EdgeOfColour, ...] = Field(default=(), repr=False)
    provenance: Provenance | None = None
    psf: PsfCalibration = Field(exclude=True, repr=False)
    noise_measurement: NoiseMeasurement | None = Field(default=None, exclude=True, repr=False)
    notes: tuple[str, ...] = Field(default=(), exclude=True, repr=False)

    @property
    def main(self) -> ColourFigures:
        """The figures of the plane that the PSF is measured on: grey, luma, or one colour."""
        return self.colours[0]

    def to_json(self) -> dict[str, Any]:
        """Return the content of lens.json, as ``standoff lens --json`` prints it."""
        return json_object(self)

    def to_dataframe(self) -> "DataFrame":
        """Return every figure as a pandas table: a row for each edge, colour and figure.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(figure_rows(self))

    def __repr__(self) -> str:
        half = self.main.median.mtf50_cy_per_px
        sharp = "no MTF50" if half is None else f"MTF50 {half.value:.4f} ± {half.err:.4f} cy/px"
        colours = ", ".join(one.colour for one in self.colours)
        return f"LensMeasurement({sharp}; {self.main.edges} edges; {colours})"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        rows = [
            (name, *(_text(getattr(one.median, name)) for one in self.colours))
            for name in FIGURE_NAMES
        ]
        return html_table(repr(self), ("", *(one.colour for one in self.colours)), rows)


def _text(value: MeasuredValue | None) -> str:
    return "" if value is None else str(value.estimate)


def colour_figures(
    edges: Mapping[Colour, Sequence[EdgeMeasurement]],
) -> tuple[tuple[ColourFigures, ...], tuple[EdgeOfColour, ...]]:
    """Return the medians of each colour, and the figures of each edge that is used."""
    colours, rows = [], []
    for colour, measured in edges.items():
        used = [edge for edge in measured if edge.is_used]
        figures = [edge_figures(edge) for edge in used]
        curves = [edge.esfr for edge in used if edge.esfr is not None]
        sharpening = sharpening_of(used)
        beyond = {} if sharpening is None else _beyond(sharpening)
        colours.append(
            ColourFigures(
                colour=colour,
                edges=len(used),
                median=median_figures(figures).model_copy(update=beyond),
                sfr=mean_transfer(curves),
            )
        )
        rows += [
            EdgeOfColour(
                colour=colour,
                image=edge.image,
                x_px=edge.x_px,
                y_px=edge.y_px,
                angle_deg=edge.angle_deg,
                length_px=edge.length_px,
                figures=one,
            )
            for edge, one in zip(used, figures, strict=True)
        ]
    return tuple(colours), tuple(rows)


def lateral_shifts(edges: Sequence[EdgeMeasurement]) -> tuple[LateralShift, ...]:
    """Return the largest shift of red and of blue; empty for photographs without colours."""
    found = []
    for colour in ("red", "blue"):
        shifts = [
            (shift, err, edge)
            for edge in edges
            if (shift := getattr(edge, f"{colour}_shift_px")) is not None
            and (err := getattr(edge, f"{colour}_shift_err_px")) is not None
        ]
        if shifts:
            shift, err, edge = max(shifts, key=lambda one: abs(one[0]))
            value = MeasuredValue(value=shift, err=err)
            found.append(
                LateralShift.model_validate(
                    {"colour": colour, "shift_px": value, "x_px": edge.x_px, "y_px": edge.y_px}
                )
            )
    return tuple(found)


def camera_figures(
    sharpening: Sharpening | None,
    capacity: CapacityFigures | None,
    noise: NoiseCalibration | None,
    sheet: EmvaSheet | None,
    focus: ThroughFocus | None,
    textures: Sequence[TextureFigures] = (),
) -> dict[str, Estimate]:
    """Return the figures that a limits file bounds under ``CAMERA_TABLES``.

    The dynamic range is one of them only if a flat reached saturation.
    """
    found: dict[str, Estimate] = {} if focus is None else focus.limits()
    if sharpening is not None:
        found["sharpening.max_overshoot"] = sharpening.overshoot
        found["sharpening.max_undershoot"] = sharpening.undershoot
    kept = [one.over_edges.estimate for one in textures if one.over_edges is not None]
    if kept:
        found["sharpening.min_texture_over_edges"] = min(kept, key=lambda one: one.value)
    if capacity is not None:
        quarter = capacity.freq_cy_per_px.index(0.25)
        found["camera.min_neq_at_half_nyquist"] = Estimate(
            value=capacity.neq[quarter], err=capacity.neq_err[quarter]
        )
        found["camera.min_information_bits_per_px"] = capacity.bits_per_px.estimate
    if noise is not None and noise.read_noise_e_err is not None:
        found["camera.max_read_noise_e"] = Estimate(
            value=noise.read_noise_e, err=noise.read_noise_e_err
        )
    if sheet is not None:
        for key, parts in (("max_prnu", sheet.prnu), ("max_dsnu_e", sheet.dsnu_e)):
            found[f"camera.{key}"] = Estimate(value=parts.total, err=parts.err)
        if sheet.dynamic_range_err_db is not None:
            found["camera.min_dynamic_range_db"] = Estimate(
                value=sheet.dynamic_range_db, err=sheet.dynamic_range_err_db
            )
    return found


def data_sheet(sheet: EmvaSheet) -> tuple[DataSheetFigure, ...]:
    """Return the data sheet of EMVA 1288 as part of the document."""
    return tuple(
        DataSheetFigure(
            figure=row.key, symbol=row.symbol, value=row.value, err=row.err, unit=row.unit
        )
        for row in sheet.rows()
    )


def figure_rows(lens: LensMeasurement) -> Iterator[dict[str, object]]:
    """Return every figure of a measurement as lines of a long table, with units and errors.

    Frequencies come in cycles per pixel, in line widths per picture height and, if the pixel pitch
    is known, in cycles (line pairs) per millimetre.
    """
    for one in lens.colours:
        where = {"colour": one.colour, "image": "", "x_px": None, "y_px": None, "angle_deg": None}
        yield from _rows(lens, where | {"part": "median"}, one.median)
    for edge in lens.edges:
        where = edge.model_dump(include={"colour", "image", "x_px", "y_px", "angle_deg"})
        yield from _rows(lens, where | {"part": "edge"}, edge.figures)
    for star in lens.stars:
        yield from _star_rows(lens, star)
    for texture in lens.textures:
        yield from _texture_rows(lens, texture)
    if lens.through_focus is not None:
        for point in lens.through_focus.points:
            where = point.model_dump(include={"x_px", "y_px", "angle_deg"})
            where |= {"part": "through_focus", "colour": lens.main.colour, "image": ""}
            for figure in _point_figures(point):
                known_as = dict(zip(("figure", "value", "err", "unit"), figure, strict=True))
                yield where | known_as | {"is_model_free": True}
    whole = {"colour": lens.main.colour, "image": "", "x_px": None, "y_px": None}
    for name, value, err, unit in _camera_figures(lens):
        where = whole | {"angle_deg": None, "part": "camera"}
        known_as = {"figure": name, "value": value, "err": err, "unit": unit}
        yield where | known_as | {"is_model_free": None}


def _star_rows(lens: LensMeasurement, star: StarFigures) -> Iterator[dict[str, object]]:
    """The star as a whole, then its sectors, whose directions stand as angles."""
    where: dict[str, object] = {"colour": lens.main.colour, "image": star.image}
    where |= {"x_px": star.x_px, "y_px": star.y_px}
    yield from _rows(lens, where | {"part": "star", "angle_deg": None}, star.figures)
    for sector in star.sectors:
        turned = {"part": "star_sector", "angle_deg": sector.direction_deg}
        yield from _rows(lens, where | turned, sector.figures)


def _texture_rows(lens: LensMeasurement, texture: TextureFigures) -> Iterator[dict[str, object]]:
    """Dead leaves by the intrinsic and by the direct method, and beside the edges."""
    where: dict[str, object] = {"colour": lens.main.colour, "image": texture.image}
    where |= {"x_px": texture.x_px, "y_px": texture.y_px, "angle_deg": None}
    yield from _rows(lens, where | {"part": "texture"}, texture.figures)
    if texture.direct_figures is not None:
        yield from _rows(lens, where | {"part": "texture_direct"}, texture.direct_figures)
    ratio = texture.over_edges
    if ratio is not None:
        known_as = {"figure": "texture_over_edges", "value": ratio.value, "err": ratio.err}
        yield where | {"part": "texture"} | known_as | {"unit": "1", "is_model_free": True}


def _rows(
    lens: LensMeasurement, where: Mapping[str, object], figures: EdgeFigures
) -> Iterator[dict[str, object]]:
    for name in FIGURE_NAMES:
        known: MeasuredValue | None = getattr(figures, name)
        if known is None:
            continue
        plain, units = name, [("1", 1.0)]
        if name.endswith("_cy_per_px"):
            plain, units = name.removesuffix("_cy_per_px"), list(frequency_units(lens))
        elif name.endswith("_px"):
            plain, units = name.removesuffix("_px"), [("px", 1.0)]
        for unit, factor in units:
            value, err = factor * known.value, factor * known.err
            known_as = {"figure": plain, "value": value, "err": err, "unit": unit}
            yield {**where, **known_as, "is_model_free": figures.is_model_free}


def frequency_units(lens: LensMeasurement) -> Iterator[tuple[str, float]]:
    """Return the units of frequency that are known, and what cycles per pixel are multiplied by."""
    yield "cy/px", 1.0
    if lens.picture_height_px is not None:
        yield "LW/PH", lw_per_ph(1.0, lens.picture_height_px)
    if lens.pixel_pitch_um is not None:
        yield "lp/mm", lp_per_mm(1.0, lens.pixel_pitch_um)


def _camera_figures(
    lens: LensMeasurement,
) -> Iterator[tuple[str, float, float | None, str]]:
    """Name, value, standard error and unit of what holds for the whole camera."""
    for shift in lens.lateral_colour:
        yield f"largest_{shift.colour}_shift", shift.shift_px.value, shift.shift_px.err, "px"
    for field in lens.lateral_fields:
        yield f"worst_{field.colour}_shift", field.worst_px.value, field.worst_px.err, "px"
        if lens.pixel_pitch_um is not None:
            pitch_um = lens.pixel_pitch_um
            value, err = pitch_um * field.worst_px.value, pitch_um * field.worst_px.err
            yield f"worst_{field.colour}_shift", value, err, "um"
        yield f"{field.colour}_growth", field.growth.value, field.growth.err, "1"
    if lens.capacity is not None:
        yield from _capacity_figures(lens.capacity)
    if lens.through_focus is not None:
        yield from _focus_figures(lens.through_focus)
    for line in lens.emva:
        yield f"emva_{line.figure}", line.value, line.err, line.unit
    if lens.noise is not None:
        for name, unit in _NOISE_UNITS.items():
            value = getattr(lens.noise, name)
            if value is not None:
                yield name, value, getattr(lens.noise, f"{name}_err", None), unit


def _point_figures(point: FocusPoint) -> Iterator[tuple[str, float, float, str]]:
    for name, unit in (("best_mm", "mm"), ("contrast", "1"), ("depth_mm", "mm")):
        known: MeasuredValue | None = getattr(point, name)
        if known is not None:
            plain = f"{name.removesuffix('_mm')}_through_focus"
            yield plain, known.value, known.err, unit


def _focus_figures(focus: ThroughFocus) -> Iterator[tuple[str, float, float, str]]:
    for known_of in (focus, focus.field):
        for name in () if known_of is None else type(known_of).model_fields:
            known = getattr(known_of, name)
            if isinstance(known, MeasuredValue):
                plain, _, unit = name.rpartition("_")
                yield f"focus_{plain}", known.value, known.err, unit


def _capacity_figures(
    capacity: CapacityFigures,
) -> Iterator[tuple[str, float, float | None, str]]:
    yield "level", capacity.level_dn, None, "DN"
    yield "noise", capacity.noise_dn, None, "DN"
    for freq, neq, err in zip(capacity.freq_cy_per_px, capacity.neq, capacity.neq_err, strict=True):
        yield f"neq_at_{freq:.2f}_cy_per_px", neq, err, "quanta/px"
    for one in capacity.detection:
        name = re.sub(r"\W+", "_", one.description)
        yield f"snr_of_{name}", one.snr.value, one.snr.err, "1"
        yield f"threshold_contrast_of_{name}", one.threshold_contrast, None, "1"
    yield "edge_location_err", capacity.edge_location_err_px, None, "px"
    if capacity.edge_bits_per_px is not None:
        known = capacity.edge_bits_per_px
        yield "information_by_edges", known.value, known.err, "bits/px"
    yield "information", capacity.bits_per_px.value, capacity.bits_per_px.err, "bits/px"
    if capacity.most_bits_per_px is not None:
        yield "information_of_full_range", capacity.most_bits_per_px, None, "bits/px"


_NOISE_UNITS: Final = {
    "gain_e_per_dn": "e/DN",
    "read_noise_e": "e",
    "black_level_dn": "DN",
    "saturation_dn": "DN",
    "saturation_e": "e",
    "linearity_error": "1",
    "dark_current_e_per_s": "e/s",
    "dsnu_e": "e",
    "prnu": "1",
    "shading": "1",
}
