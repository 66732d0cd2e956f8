"""Make the pictures of the tutorials from what their commands write.

Run with ``python -m scripts.make_tutorial_pictures [--folder docs/images]``; it takes some minutes.
"""

import argparse
import os
import shutil
import tempfile
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import tifffile
from matplotlib.figure import Figure
from numpy.typing import NDArray

import standoff
from scripts.report_pictures import save_picture
from tests.docs.blocks import CHECKOUT, blocks, terminal

READ = ("configs", "tests/data", "standoff/example_photographs")
Picture = NDArray[np.uint8]
OPERATOR = "ada"
FREQUENCIES = np.linspace(0, 0.5, 101)


def _run_tutorial(name: str, folder: Path) -> Path:
    """Type the tutorial ``name`` into a terminal; return the folder it ends in."""
    for read in READ:
        shutil.copytree(CHECKOUT / read, folder / read)
    with terminal(folder) as typed:
        for block in blocks((CHECKOUT / "docs" / f"tutorial-{name}.md").read_text("utf-8")):
            typed.run(block)
    return typed.folder


def _grey(path: Path, white_dn: float) -> Picture:
    """The mean of a capture as it would look on a screen."""
    return _shown(tifffile.imread(path)[0], white_dn)


def _shown(level_dn: NDArray[np.float64], white_dn: float) -> Picture:
    """Linear levels with the usual gamma of a screen, 8 bits."""
    light = np.clip(level_dn / white_dn, 0, 1)
    return np.rint(255 * light ** (1 / 2.2)).astype(np.uint8)


def _beside(pictures: list[Picture]) -> Picture:
    """Pictures of one height in a row, with white between them."""
    gap = np.full((pictures[0].shape[0], 8, *pictures[0].shape[2:]), 255, np.uint8)
    row = [part for picture in pictures for part in (picture, gap)][:-1]
    return np.hstack(row)


def read(path: Path) -> Picture:
    """A picture in colour, as OpenCV orders it."""
    picture = cv2.imread(str(path))
    if picture is None:
        raise OSError(f"cannot read {path}")
    return picture.astype(np.uint8)


def _smaller(picture: Picture, cols: int) -> Picture:
    """``picture`` scaled down to a width."""
    rows = round(picture.shape[0] * cols / picture.shape[1])
    return cv2.resize(picture, (cols, rows), interpolation=cv2.INTER_AREA).astype(np.uint8)


def _transfer(path: Path, *, along_y: bool = False) -> NDArray[np.float64]:
    """The measured transfer of a psf.json at ``FREQUENCIES`` along x or y."""
    measured = standoff.read_psf(path).transfer_2d
    if measured is None:
        raise ValueError(f"{path} has no measured transfer")
    none = np.zeros_like(FREQUENCIES)
    return measured.otf(none, FREQUENCIES) if along_y else measured.otf(FREQUENCIES, none)


def _save(path: Path, picture: Picture) -> None:
    """Write a picture, JPEG at a quality of 85."""
    how = [cv2.IMWRITE_JPEG_QUALITY, 85] if path.suffix == ".jpg" else []
    if not cv2.imwrite(str(path), picture, how):
        raise OSError(f"cannot write {path}")


def _draw_operator(folder: Path, images: Path) -> None:
    """The sweep's plot, the four placements, and the top of the report."""
    _save(images / "tutorial-focus.png", _smaller(read(folder / "focus.png"), 640))
    placed = sorted((folder / "session" / "captures").glob("*_h0200.000mm.tif"))
    small = [_grey(path, 3000)[::2, ::2] for path in placed]
    _save(images / "tutorial-targets.png", _beside(small))
    save_picture(folder / "session" / "results" / "report.html", images / "report-session.jpg")


def _draw_lens(folder: Path, images: Path) -> None:
    """The photographed edge with its contrast, and the transfer of two lenses."""
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 2.4))
    left.imshow(read(CHECKOUT / "tests/data/edges/v_edge.tif")[..., ::-1])
    for x, y, name in ((75, 75, "a"), (61, 225, "b")):
        left.plot([x - 9, x + 9], [y - 1, y + 1], color="tab:red")
        left.annotate(name, (x + 12, y), color="tab:red")
    left.set(title="v_edge.tif / px")
    right.plot(FREQUENCIES, _transfer(folder / "both.json"))
    right.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
    right.set(xlabel="frequency across the edge / (cy/px)", ylabel="contrast", xlim=(0, 0.5))
    figure.savefig(images / "tutorial-edge.png", dpi=90)
    figure = Figure(figsize=(6, 3.2), layout="constrained")
    axes = figure.subplots()
    for name in ("both", "august", "september"):
        axes.plot(FREQUENCIES, _transfer(folder / f"{name}.json"), label=f"{name}.json, along x")
    along_y = _transfer(folder / "august.json", along_y=True)
    axes.plot(FREQUENCIES, along_y, "--", label="august.json, along y")
    axes.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
    axes.set(xlabel="frequency / (cy/px)", ylabel="contrast", xlim=(0, 0.5))
    axes.legend(fontsize=8)
    figure.savefig(images / "tutorial-mtf.png", dpi=90)


def _draw_pair(folder: Path, images: Path) -> None:
    """The photographs, the comparison, and the map of the detection limit."""
    names = ("nearer.png", "further.png", "later.png")
    pair = [read(folder / name) for name in names]
    for x, y in ((60, 110), (400, 180)):
        cv2.circle(pair[2], (x, y), 14, (255, 255, 255), 1, cv2.LINE_AA)
    _save(images / "tutorial-pair.jpg", _smaller(_beside(pair), 946))
    compared = read(folder / "changed" / "changes-figure.png")
    _save(images / "tutorial-changes.jpg", _smaller(compared, 900))
    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.subplots()
    limit = tifffile.imread(folder / "unchanged" / "limit.tif")
    drawn = axes.imshow(limit, norm="log", vmin=5, vmax=150, cmap="viridis")
    figure.colorbar(drawn, label="a spot of 1.5 px is found from / DN")
    for x, y in ((60, 110), (400, 180)):
        axes.plot(x, y, "o", markersize=12, markerfacecolor="none", color="tab:red")
    figure.savefig(images / "tutorial-limit.png", dpi=80)


def _draw_followup(folder: Path, images: Path) -> None:
    """The lesion with the spot that has to be found, and d' against zoom."""
    mean = tifffile.imread(next((folder / "scenes").glob("0004*")))[0]
    rows, cols = np.indices(mean.shape)
    spot = np.exp(-((cols - 120) ** 2 + (rows - 60) ** 2) / (2 * 2.0**2))
    _save(
        images / "tutorial-lesion.png",
        _beside([_shown(mean - strength * spot, 3000) for strength in (1000, 100)]),
    )
    _save(images / "tutorial-curves.png", _smaller(read(folder / "curves-noise.png"), 640))


DRAWN = {
    "operator": _draw_operator,
    "lens-report": _draw_lens,
    "two-photographs": _draw_pair,
    "follow-up-system": _draw_followup,
}


def main() -> None:
    """Run all tutorials and write their pictures."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=CHECKOUT / "docs" / "images")
    images = parser.parse_args().folder
    mpl.rcParams["font.size"] = 9
    os.environ["LOGNAME"] = OPERATOR
    with tempfile.TemporaryDirectory() as scratch:
        for name, draw in DRAWN.items():
            draw(_run_tutorial(name, Path(scratch) / name / "standoff"), images)


if __name__ == "__main__":
    main()
