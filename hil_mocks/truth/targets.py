"""The catalogue of the simulated bench's targets."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import cv2
import numpy as np

from hil_mocks.truth.relief import Relief, Thing
from hil_mocks.truth.scenes import (
    BLACK_PAPER,
    PHOTOGRAPHS,
    WHITE_PAPER,
    CellGrid,
    Edge,
    Placed,
    Rectangle,
    Scene,
    SumOfScenes,
    Uniform,
    ZonePlate,
    print_lesion,
    print_photograph,
)

TargetKind = Literal["edge", "texture", "chart", "board", "flat", "dark"]

BOARD_COLS, BOARD_ROWS = 11, 8
BOARD_SQUARE_MM = 12.0
CELLS_PER_SQUARE = 8
"""A square is 8 cells wide and its marker 6: 4 bits and a border cell on each side."""

CHART_PITCH_MM = 36.0
CHART_SQUARE_MM = 18.0
CHART_SLANT_DEG = 5.0
"""Slant of the edges, as in ISO 12233:2017 (about 5 degrees)."""

CHART_GROUND = 0.6


TABLET_STEPS = 5
TABLET_STEP_MM = 24.0
TABLET_DENSITY = 4.0
"""Optical density of the darkest step: 1 : 10,000. Step tablets of films go that far, prints do not
(ISO 15739 measures the dynamic range of cameras with such a chart)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Target:
    """A target: its kind in a capture plan, and a function that makes its scene."""

    kind: TargetKind
    description: str
    make: Callable[[], Scene]


def _charuco_board() -> CellGrid:
    """A ChArUco board of 11 x 8 squares of 12 mm with markers of 9 mm (DICT_4X4_50).

    Laid out as OpenCV's `cv2.aruco.CharucoBoard`: the top left square is black, and markers
    fill the white squares row by row.
    """
    n = CELLS_PER_SQUARE
    cells = np.full((BOARD_ROWS * n, BOARD_COLS * n), WHITE_PAPER)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    marker_id = 0
    for row in range(BOARD_ROWS):
        for col in range(BOARD_COLS):
            square = cells[row * n : (row + 1) * n, col * n : (col + 1) * n]
            if (row + col) % 2 == 0:
                square[...] = BLACK_PAPER
                continue
            bits = cv2.aruco.generateImageMarker(dictionary, marker_id, n - 2)
            square[1:-1, 1:-1] = np.where(bits > 0, WHITE_PAPER, BLACK_PAPER)
            marker_id += 1
    return CellGrid(cells=cells, cell_mm=BOARD_SQUARE_MM / n)


def _step_tablet() -> CellGrid:
    """A transparent step tablet on a light box: 25 steps from 1 to 1/10,000 in an opaque frame.

    The light box is as bright as white paper. Densities grow row by row, and every other row from
    right to left, so that neighbours in a row differ by a factor of 1.5.
    """
    density = np.linspace(0.0, TABLET_DENSITY, TABLET_STEPS**2).reshape(TABLET_STEPS, -1)
    density[1::2] = density[1::2, ::-1]
    dark = 10.0**-TABLET_DENSITY
    return CellGrid(cells=10.0**-density, cell_mm=TABLET_STEP_MM, margin=dark)


def _resolution_chart() -> SumOfScenes:
    """Slanted dark squares all over the frame, with zone plates and bars between them.

    The squares give edges for a map of sharpness over the field (as in the e-SFR of ISO 12233),
    the zone plates show aliasing in all directions up to 3 cycles/mm, and the bars are those of a
    classical resolution target.
    """
    parts: list[tuple[Placed, float]] = []
    square = Rectangle(
        width_mm=CHART_SQUARE_MM, height_mm=CHART_SQUARE_MM, contrast=BLACK_PAPER - CHART_GROUND
    )
    plate = ZonePlate(amplitude=0.36, window_mm=4.0, freq_cy_per_mm=1.1)
    for row in range(-6, 7):
        for col in range(-8, 9):
            x_mm, y_mm = col * CHART_PITCH_MM, row * CHART_PITCH_MM
            slant_deg = CHART_SLANT_DEG * (1 if (row + col) % 2 else -1)
            parts.append(
                (
                    Placed(scene=square, x_mm=x_mm, y_mm=y_mm, angle_deg=slant_deg),
                    CHART_SQUARE_MM,
                )
            )
            middle_mm = (x_mm + CHART_PITCH_MM / 2, y_mm + CHART_PITCH_MM / 2)
            if (row + col) % 2:
                parts.append((Placed(scene=plate, x_mm=middle_mm[0], y_mm=middle_mm[1]), 21.0))
            else:
                parts += _bars(*middle_mm)
    return SumOfScenes(Uniform(level=CHART_GROUND), parts)


def _bars(x_mm: float, y_mm: float) -> list[tuple[Placed, float]]:
    """Four groups of five dark bars of 0.5, 1, 1.5 and 2 line pairs per mm."""
    bars: list[tuple[Placed, float]] = []
    for group, pairs_per_mm in enumerate((0.5, 1.0, 1.5, 2.0)):
        period_mm = 1 / pairs_per_mm
        bar = Rectangle(width_mm=period_mm / 2, height_mm=3.0, contrast=BLACK_PAPER - CHART_GROUND)
        bars += [
            (Placed(scene=bar, x_mm=x_mm + k * period_mm, y_mm=y_mm + 4.0 * (group - 1.5)), 3.0)
            for k in range(-2, 3)
        ]
    return bars


def _things_on_a_print() -> Relief:
    """A coin, three steps and a leaf on the print of the photograph brick."""

    def cut_out(name: str, x_mm: float, y_mm: float) -> Placed:
        return Placed(scene=print_photograph(name), x_mm=-x_mm, y_mm=-y_mm)

    steps = tuple(
        Thing(
            outline="plate",
            x_mm=-28.0 + 14.0 * number,
            y_mm=-18.0,
            half_x_mm=7.0,
            half_y_mm=12.0,
            height_mm=height_mm,
            top=cut_out("grass", 14.0 * number, 30.0),
        )
        for number, height_mm in enumerate((4.0, 8.0, 16.0))
    )
    return Relief(
        ground=print_photograph("brick"),
        things=(
            *steps,
            Thing(
                outline="coin",
                x_mm=32.0,
                y_mm=-14.0,
                half_x_mm=13.0,
                half_y_mm=13.0,
                height_mm=2.3,
                top=cut_out("coins", 20.0, 10.0),
            ),
            Thing(
                outline="leaf",
                x_mm=14.0,
                y_mm=26.0,
                half_x_mm=24.0,
                half_y_mm=9.0,
                height_mm=6.0,
                angle_deg=20.0,
                top=cut_out("gravel", -30.0, 20.0),
            ),
        ),
    )


TARGETS: dict[str, _Target] = {
    "edge": _Target(kind="edge", description="black paper on white paper", make=Edge),
    **{
        name: _Target(
            kind="texture",
            description=f"print of the photograph {name}",
            make=partial(print_photograph, name),
        )
        for name in PHOTOGRAPHS
    },
    "lesion": _Target(kind="texture", description="print of a skin lesion", make=print_lesion),
    "relief": _Target(
        kind="texture",
        description="a coin, steps and a leaf on a print of the photograph brick",
        make=_things_on_a_print,
    ),
    "chart": _Target(
        kind="chart", description="slanted squares and zone plates", make=_resolution_chart
    ),
    "board": _Target(kind="board", description="ChArUco board", make=_charuco_board),
    "step tablet": _Target(
        kind="chart", description="steps of light from 1 to 1/10,000", make=_step_tablet
    ),
    "flat": _Target(kind="flat", description="white paper", make=Uniform),
    "dark": _Target(kind="dark", description="lens cap", make=partial(Uniform, level=0.0)),
}
"""Target names of the simulated bench."""


@cache
def scene_of(target: str) -> Scene:
    """The scene of a target, made once; ValueError, which lists them, if there is none."""
    if target not in TARGETS:
        raise ValueError(
            f"no target {target!r} on the simulated bench; it has {', '.join(TARGETS)}"
        )
    return TARGETS[target].make()
