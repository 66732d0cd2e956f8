"""The page of a lens and its camera."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.files import InputFile, Provenance
from analysis.reports import lens_report
from analysis.reports._lens import _plot_edge_profile
from calibration.edges import EdgeMeasurement
from calibration.estimate import NORMAL_95
from calibration.lens import (
    Colour,
    LensMeasurement,
    SharpeningFigures,
    camera_figures,
    capacity_figures,
    colour_figures,
    data_sheet,
    figure_rows,
    lateral_shifts,
)
from calibration.noise import (
    FrameGroup,
    NoiseCaptures,
    NoiseMeasurement,
    Saturation,
    noise_captures,
    noise_of_captures,
)
from calibration.sharpness import SharpnessLimits, sharpening_of
from simulation.arrays import FloatArray
from tests.analysis.html_page import Page
from tests.calibration.known import known
from tests.calibration.lens.camera import NOISE, calibrated, square
from tests.calibration.sharpness.edges import edge_of


def captures() -> NoiseCaptures:
    rng = np.random.default_rng(4)
    groups = []
    for kind, light_e in (("dark", 0), *(("flat", light) for light in (2000, 5000, 9000, 12000))):
        group = FrameGroup("dark" if kind == "dark" else "flat", f"{kind} {light_e}", light_e or 21)
        for _ in range(4):
            electrons = rng.poisson(light_e, (60, 80)) + rng.normal(0, 8.0, (60, 80))
            group.add(np.round(50 + electrons / 4.0).astype(np.uint16))
        group.finish()
        groups.append(group)
    return noise_captures(groups, max_level_dn=4095)


SEEN = Saturation(level_dn=4095.0, err_dn=0.3)


@pytest.fixture(scope="module")
def noise() -> NoiseMeasurement:
    return noise_of_captures(captures())


def lens(noise: NoiseMeasurement | None = None, *, amount: float = 0.0) -> LensMeasurement:
    psf = calibrated(amount=amount).model_copy(
        update={"labels": {"customer": "Muster AG", "operator": "A. Smith", "lens": "35 mm"}}
    )
    colours, edges = colour_figures({"grey": psf.edges})
    capacity, notes = capacity_figures(psf, NOISE if noise is None else noise.calibration)
    return LensMeasurement(
        labels=psf.labels,
        picture_width_px=psf.picture_width_px,
        picture_height_px=psf.picture_height_px,
        colours=colours,
        edges=edges,
        sharpening=SharpeningFigures.of(known(sharpening_of(psf.edges_used))),
        capacity=capacity,
        psf=psf,
        noise_measurement=noise,
        noise=NOISE if noise is None else noise.calibration,
        emva=() if noise is None else data_sheet(noise.emva),
        notes=notes,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Profile:
    """An edge profile that rises from 0 to a plateau, known without error."""

    plateau: float
    reach_px: float = 6.0

    def esf(self, distance_px: FloatArray) -> FloatArray:
        return np.where(distance_px > 0, self.plateau, 0.0)

    def esf_err(self, distance_px: FloatArray) -> FloatArray:
        return np.zeros_like(distance_px)


def load(name: str) -> NDArray[np.float64]:
    seed = int(name.removeprefix("square-").removesuffix(".tif"))
    return square((6.0, 50.0)[seed], seed).image_dn


def page_of(found: LensMeasurement) -> tuple[str, Page]:
    html = lens_report(found, load).html()
    return html, Page(html)


def test_the_first_page_names_people_standards_and_six_figures(noise: NoiseMeasurement) -> None:
    html, page = page_of(lens(noise))
    for text in ("Muster AG", "A. Smith", "35 mm", "ISO 12233:2024", "EMVA 1288 R4", "standoff"):
        assert text in page.text
    assert html.count('<div class="verdict">') == 6
    assert page.fetched == []


def test_only_standards_by_which_something_was_measured_are_named(
    noise: NoiseMeasurement,
) -> None:
    assert "standards ISO 12233:2024 (e-SFR, annex D), EMVA 1288" in page_of(lens(noise))[1].text
    found = lens()
    front = page_of(found)[1].text
    assert "standards ISO 12233:2024 (e-SFR, annex D) software" in front
    by_gaussian = tuple(
        edge.model_copy(
            update={"figures": edge.figures.model_copy(update={"is_model_free": False})}
        )
        for edge in found.edges
    )
    assert " standards " not in page_of(found.model_copy(update={"edges": by_gaussian}))[1].text


def test_the_page_says_of_which_light_the_quanta_are(noise: NoiseMeasurement) -> None:
    text = page_of(lens(noise))[1].text
    assert "above black, the bright side of the edges, where" in text
    assert "Published figures by edges may leave out the half" in text


def test_the_dynamic_range_has_its_interval_or_says_where_saturation_is_from(
    noise: NoiseMeasurement,
) -> None:
    sheet = noise.emva
    assert not sheet.is_saturated
    value = f"{sheet.dynamic_range_db:.1f} dB"
    assert f"{value} {value}, saturation from the pixel format; " in page_of(lens(noise))[1].text
    seen = replace(noise, transfer=replace(noise.transfer, saturation=SEEN))
    assert re.search(
        r"dynamic range \d\d\.\d dB \d\d\.\d+ ± 0\.\d+ dB; ", page_of(lens(seen))[1].text
    )


def test_the_dynamic_range_is_judged_only_if_saturation_was_seen(noise: NoiseMeasurement) -> None:
    seen = replace(noise, transfer=replace(noise.transfer, saturation=SEEN))
    key, calibration = "camera.min_dynamic_range_db", noise.calibration
    assert key not in camera_figures(None, None, calibration, noise.emva, None)
    found = camera_figures(None, None, calibration, seen.emva, None)[key]
    assert found.value == seen.emva.dynamic_range_db
    assert found.err > 0
    limits = SharpnessLimits.model_validate({"camera": {"min_dynamic_range_db": 1.0}})
    [judged] = known(lens().psf.judged(limits, "limits.toml", {}).verdict).limits
    assert judged.outcome == "unsure"
    assert "give --dark and --flat, one of them saturated" in known(judged.reason)


def test_without_limits_there_is_no_banner_and_with_them_there_is() -> None:
    html, _ = page_of(lens())
    assert 'class="outcome' not in html
    limits = SharpnessLimits.model_validate({"mtf50": {"min_cy_per_px": 0.01}})
    found = lens()
    judged = found.psf.judged(limits, "limits.toml")
    html, page = page_of(found.model_copy(update={"psf": judged, "verdict": judged.verdict}))
    assert 'class="outcome pass"' in html
    assert "1 limit of limits.toml: 1 passed." in page.texts


def test_a_figure_has_one_value_wherever_it_stands(noise: NoiseMeasurement) -> None:
    found = lens(noise)
    _, page = page_of(found)
    half = known(found.main.median.mtf50_cy_per_px).value
    medians = set(re.findall(r"MTF50, median of \d+ edges (\d\.\d+) cy/px (\d\.\d+)", page.text))
    assert medians == {(f"{half:.3f}", f"{half:.4f}")}
    rows = re.findall(r"MTF50 cy/px (\d\.\d+)", page.text)
    assert rows == [f"{half:.4f}"]
    over = f"{100 * known(found.main.median.overshoot).value:.1f}"
    assert re.findall(r"overshoot (\d\.\d) %", page.text) == [over]


def test_sharpened_photographs_are_named_on_the_page() -> None:
    assert "The photographs are sharpened" in page_of(lens(amount=0.6))[1].text
    assert "no sign of sharpening" in page_of(lens())[1].text


def test_the_band_of_the_edge_profile_counts_the_scatter_of_the_edges() -> None:
    # Five edges whose profiles differ by an overshoot of 0, 0.1 .. 0.4 of the contrast and have no
    # noise: the median modulus about their median is 0.1, and sigma 0.14826.
    edges = [
        edge_of().model_copy(update={"esfr": _Profile(plateau=1.0 + 0.1 * number)})
        for number in range(5)
    ]
    axes = known(_plot_edge_profile(edges)).axes[0]
    [band] = axes.collections
    at_the_end = np.asarray(band.get_paths()[0].vertices)
    heights = at_the_end[np.isclose(at_the_end[:, 0], 6.0), 1]
    half = NORMAL_95 * np.sqrt(np.pi / 2) * 0.1482602 / np.sqrt(5)
    assert 0.5 * (heights.max() - heights.min()) == pytest.approx(half, rel=1e-5)


def test_the_data_sheet_is_on_the_page_where_there_are_darks_and_flats(
    noise: NoiseMeasurement,
) -> None:
    sheet = "EMVA 1288 data sheet, linear model"
    assert sheet in page_of(lens(noise))[1].headings
    assert sheet not in page_of(lens())[1].headings


def all_of_it(noise: NoiseMeasurement) -> LensMeasurement:
    """Four colours, limits, remarks, lateral chromatic aberration, many files and edges."""
    found = lens(noise)
    shifts = {
        f"{colour}_shift_{end}": value
        for colour, end, value in (
            *(("red", "px", 0.1), ("red", "err_px", 0.01)),
            *(("blue", "px", -0.1), ("blue", "err_px", 0.01)),
        )
    }
    edges = tuple(
        edge.moved(step, 1).model_copy(update=shifts)
        for edge in found.psf.edges
        for step in (0, 1, 2)
    )
    limits = SharpnessLimits.model_validate(
        {
            "mtf50": {"min_cy_per_px": 0.1, "min_lw_per_ph": 100, "centre_min_cy_per_px": 0.1},
            "lateral_colour": {"max_px": 0.2},
            "sigma": {"max_px": 1.0, "optical_max_px": 1.0},
            "uniformity": {"corner_to_centre_min": 0.5, "corner_to_corner_min": 0.5},
            "sharpening": {"max_overshoot": 0.05, "max_undershoot": 0.05},
            "camera": {
                **dict.fromkeys(("min_neq_at_half_nyquist", "min_dynamic_range_db"), 1.0),
                **dict.fromkeys(("max_read_noise_e", "max_dsnu_e"), 20.0),
                **{"min_information_bits_per_px": 1.0, "max_prnu": 0.05},
            },
        }
    )
    figures = camera_figures(
        sharpening_of(edges), found.capacity, noise.calibration, noise.emva, None
    )
    psf = found.psf.model_copy(update={"edges": edges}).judged(limits, "limits.toml", figures)
    colours: dict[Colour, tuple[EdgeMeasurement, ...]] = {
        "luma": edges, "red": edges, "green": edges, "blue": edges,
    }  # fmt: skip
    medians, rows = colour_figures(colours)
    files = tuple(InputFile(path=f"flats/{k}.tif", sha256=f"{k:064d}") for k in range(60))
    return found.model_copy(
        update={
            "psf": psf,
            "verdict": psf.verdict,
            "colours": medians,
            "edges": rows,
            "lateral_colour": lateral_shifts(edges),
            "pixel_pitch_um": 4.5,
            "notes": tuple(f"remark {k} says what was assumed of a photograph" for k in range(7)),
            "provenance": Provenance(
                version="1.0.0",
                created="2026-11-28T10:00:00Z",
                command="standoff lens",
                encoding="linear",
                inputs=files,
            ),
        }
    )


@pytest.mark.slow
def test_it_prints_on_at_most_eight_pages(noise: NoiseMeasurement) -> None:
    weasyprint = pytest.importorskip("weasyprint")
    html, page = page_of(all_of_it(noise))
    assert "Lateral colour" in page.headings
    assert "56 files, listed in the JSON file" in page.text
    assert len(weasyprint.HTML(string=html).render().pages) <= 8


def test_the_table_has_every_figure_with_unit_and_error(noise: NoiseMeasurement) -> None:
    found = lens(noise)
    rows = list(figure_rows(found))
    half = known(found.main.median.mtf50_cy_per_px)
    height = known(found.picture_height_px)
    medians = {
        row["unit"]: row["value"]
        for row in rows
        if row["part"] == "median" and row["figure"] == "mtf50"
    }
    assert medians == {"cy/px": half.value, "LW/PH": pytest.approx(2 * height * half.value)}
    names = [str(row["figure"]) for row in rows if row["part"] == "camera"]
    assert all(re.fullmatch(r"\w+(\.\d+\w+)?", name) for name in names)
    sheet = noise.emva
    stated = {
        (row["figure"], row["unit"]): (row["value"], row["err"])
        for row in rows
        if str(row["figure"]).startswith("emva_")
    }
    assert stated["emva_dynamic_range", "dB"] == (sheet.dynamic_range_db, None)
    assert stated["emva_dsnu", "e"] == (sheet.dsnu_e.total, sheet.dsnu_e.err)
    assert stated["emva_prnu_of_rows", "%"] == (100 * sheet.prnu.rows, None)
    assert stated["emva_threshold", "e"][0] == sheet.threshold_e
    assert {row["is_model_free"] for row in rows if row["part"] == "edge"} == {True}
    assert {
        "snr_of_disc_of_5_px",
        "information",
        "gain_e_per_dn",
        "edge_location_err",
        "neq_at_0.25_cy_per_px",
    } <= set(names)
    assert len({tuple(row) for row in rows}) == 1  # the same columns in every row
