import csv
import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from analysis.changes._document import Change
from standoff.cli import run
from tests.standoff.changed_photographs import (
    FAR,
    NEAR,
    ZOOM,
    changed_pair,
    write_levels,
    write_psf,
)
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

pytestmark = pytest.mark.slow

FILES = [
    *("changes-figure.png", "changes.csv", "changes.json", "changes.png", "compared.png"),
    *("difference.tif", "limit.tif", "plain-difference.tif", "pose-difference.tif", "report.html"),
    *("significance.tif", "uncertainty.tif"),
]


@pytest.fixture
def psf_file(tmp_path: Path) -> Path:
    return write_psf(tmp_path / "psf.json")


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A reference, and a follow-up with sixteen changes of 25 DN in the scene."""
    one, folder = changed_pair(2, 25.0), tmp_path_factory.mktemp("photographs")
    return (
        write_levels(folder / "near.tif", one.reference),
        write_levels(folder / "far.tif", one.followup),
    )


@pytest.fixture(scope="module")
def compared(photographs: tuple[Path, Path]) -> Path:
    """What the two give without any option, and page.html beside them."""
    out = photographs[0].parent / "out"
    words = ("changes", *photographs, "--out", out, "--report", out.parent / "page.html")
    assert run([str(word) for word in words]) == 0
    return out


def test_changes_are_registered_found_and_written(
    command: Command, psf_file: Path, photographs: tuple[Path, Path], tmp_path: Path
) -> None:
    one = changed_pair(2, 25.0)
    noise = tmp_path / "noise.json"
    noise.write_text(
        '{"schema": "standoff.noise/1", "gain_e_per_dn": 60.0, "read_noise_e": 10.0,'
        ' "black_level_dn": 0.0, "frames_averaged": 1}'
    )
    out = tmp_path / "out"
    words = ("--psf", psf_file, "--noise", noise, "--out", out)
    told = command.done("changes", *photographs, *words)
    document = json.loads((out / "changes.json").read_text())
    assert document["zoom"] == pytest.approx(ZOOM, abs=0.005)
    # The scene was photographed through no lens at all.
    assert document["distortion_k1"] == pytest.approx(0.0, abs=4 * document["distortion_k1_err"])
    # The psf.json is that of the photographs.
    assert document["kernel"] == "calibrated"
    assert_provenance(document, "changes", *photographs, psf_file, noise)
    assert told.out.splitlines()[0] == "16 changes"
    assert told.out.splitlines()[-1].startswith("no change of focus: the blur is what psf.json")
    assert (
        f"{document['changed_px']} of {document['compared_px']} pixels changed by more than "
        in told.out
    )
    assert f"wrote {out}\n" in told.out
    mask = np.asarray(Image.open(out / "changes.png")) > 0
    assert mask.sum() == document["changed_px"]
    core = one.truth > 0.5 * one.truth.max()
    assert mask[core].mean() > 0.95
    assert not mask[one.truth < 1e-3 * one.truth.max()].any()
    assert sorted(path.name for path in out.iterdir()) == FILES


def test_a_psf_of_another_focus_is_told_with_its_significance(
    command: Command, photographs: tuple[Path, Path], tmp_path: Path
) -> None:
    # sqrt(0.9^2 - 0.6^2) px are missing from it.
    other = {"schema": "standoff.psf/1", "sigma_x_px": 0.6, "sigma_y_px": 0.6, "rho": 0.0}
    (tmp_path / "other.json").write_text(json.dumps(other))
    words = ("changes", *photographs, "--psf", tmp_path / "other.json", "--out", tmp_path / "out")
    done = command.done(*words, "--json")
    document = json.loads(done.out)
    assert document["kernel"] == "both"
    assert any("the focus has changed by" in warning for warning in document["warnings"])
    assert "standard errors" in done.err
    assert len(document["changes"]) == 16
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert page.index("the focus has changed by") < page.index("Before and after")


def test_two_photographs_and_nothing_else_give_the_list_of_what_changed(compared: Path) -> None:
    document = json.loads((compared / "changes.json").read_text())
    assert document["kernel"] == "pair"
    assert document["saturated_px"] == 0
    assert document["warnings"] == []
    assert np.shape(document["homography"]) == (3, 3)
    changes = document["changes"]
    assert len(changes) == 16
    assert all(set(change) == set(Change.model_fields) for change in changes)
    truth = changed_pair(2, 25.0).truth
    for change in changes:
        # Each stands on a change: one pixel beside its centre it still has 95 % of its peak.
        assert truth[round(change["y_px"]), round(change["x_px"])] > 0.8 * truth.max()
        assert change["reference_x_px"] == pytest.approx(
            ZOOM * (change["x_px"] - (FAR[1] - 1) / 2) + (NEAR[1] - 1) / 2 - 2.3, abs=0.3
        )
    with (compared / "changes.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    numbers = ("x_px", "y_px", "area_px", "amplitude_dn", "significance", "spot_sigma_px")
    assert [[float(line[name]) for name in numbers] for line in lines] == [
        [change[name] for name in numbers] for change in changes
    ]
    assert {line["displacement_x_px"] for line in lines} == {""}
    assert {line["is_moved"] for line in lines} == {"False"}
    page = (compared / "report.html").read_text("utf-8")
    assert page.count('<g data-change="') == 3 * 16
    assert "src=" not in page.replace('src="data:', "")
    assert "http://" not in page.replace('xmlns="http://www.w3.org', "").replace(
        '"http://www.w3.org/2000/svg"', ""
    )


def test_the_report_goes_where_it_is_asked_for(
    command: Command, photographs: tuple[Path, Path], compared: Path, tmp_path: Path
) -> None:
    pages = compared / "report.html", compared.parent / "page.html"
    own, other = (path.read_text("utf-8") for path in pages)
    assert own.split("<footer")[0][:5000] == other[:5000]
    assert "16 changes" in other
    command.refused(2, "changes", *photographs, "--out", tmp_path / "o", "--report", tmp_path / "r")


def test_a_mask_leaves_its_pixels_out(
    command: Command, photographs: tuple[Path, Path], tmp_path: Path
) -> None:
    left_out = np.zeros(FAR, np.uint8)
    left_out[:, : FAR[1] // 2] = 1
    Image.fromarray(left_out).save(tmp_path / "mask.png")
    out = tmp_path / "out"
    document = command.document(
        "changes", *photographs, "--mask", tmp_path / "mask.png", "--out", out
    )
    assert len(document["changes"]) == 8
    assert min(change["x_px"] for change in document["changes"]) > FAR[1] / 2
    compared = np.asarray(Image.open(out / "compared.png")) > 0
    assert not compared[left_out > 0].any()
    assert_provenance(document, "changes", *photographs, tmp_path / "mask.png")


def test_a_pose_that_is_known_roughly_is_a_way_on(
    command: Command, photographs: tuple[Path, Path], tmp_path: Path
) -> None:
    """Each of the three, off by what an operator may be off by."""
    middle = [(n - 1) / 2 for n in (NEAR[1], NEAR[0], FAR[1], FAR[0])]
    rough = np.array(
        [
            [1.52, 0.01, middle[0] - 1.52 * middle[2]],
            [0.0, 1.49, middle[1] - 1.49 * middle[3]],
            [0, 0, 1],
        ]
    )
    document = {
        "schema": "standoff.homography/1",
        "matrix": rough.tolist(),
        "size": [FAR[1], FAR[0]],
    }
    (tmp_path / "H.json").write_text(json.dumps(document))
    corners = np.array([[20, 20], [180, 25], [25, 150], [185, 140], [100, 80]], dtype=float)
    there = ZOOM * (corners - middle[2:]) + middle[:2] - [2.3, 0]
    rows = [",".join(map(str, [*a, *np.round(b)])) for a, b in zip(corners, there, strict=True)]
    header = "followup_x_px,followup_y_px,reference_x_px,reference_y_px"
    (tmp_path / "p.csv").write_text("\n".join([header, *rows]))
    for name, hint in (
        ("zoom", ("--expect-zoom", 1.4)),
        ("homography", ("--homography", tmp_path / "H.json")),
        ("points", ("--points", tmp_path / "p.csv")),
    ):
        found = command.document("changes", *photographs, *hint, "--out", tmp_path / name)
        assert found["zoom"] == pytest.approx(ZOOM, abs=0.005)
        assert len(found["changes"]) == 16


def test_a_mirrored_follow_up_is_refused_or_has_the_same_changes_in_mirrored_places(
    command: Command, photographs: tuple[Path, Path], compared: Path, tmp_path: Path
) -> None:
    near, far = photographs
    mirrored = tmp_path / "mirrored.tif"
    tifffile.imwrite(mirrored, np.ascontiguousarray(tifffile.imread(far)[:, ::-1]))
    err = command.refused(1, "changes", near, mirrored, "--out", tmp_path / "refused")
    assert err.count("\n") == 1
    assert "mirrored" in err
    assert "--mirrored" in err
    words = (near, mirrored, "--mirrored", "--out", tmp_path / "out")
    made = {
        "as-is": json.loads((compared / "changes.json").read_text()),
        "mirrored": command.document("changes", *words),
    }
    assert np.linalg.det(made["mirrored"]["homography"]) < 0
    assert made["mirrored"]["zoom"] == pytest.approx(made["as-is"]["zoom"], abs=2e-3)
    assert made["mirrored"]["extra_blur_px2"] == pytest.approx(
        made["as-is"]["extra_blur_px2"], abs=0.02
    )
    places = [
        sorted((one["y_px"], one["x_px"]) for one in made[name]["changes"])
        for name in ("as-is", "mirrored")
    ]
    there = sorted((y, FAR[1] - 1 - x) for y, x in places[1])
    # Where they lie is known to a fraction of their width.
    np.testing.assert_allclose(there, places[0], atol=0.5)


def test_an_ordinary_follow_up_is_not_mirrored_because_somebody_says_so(
    command: Command, photographs: tuple[Path, Path], tmp_path: Path
) -> None:
    err = command.refused(1, "changes", *photographs, "--mirrored", "--out", tmp_path / "out")
    assert "leave out --mirrored" in err


@pytest.mark.parametrize(
    ("option", "content", "said"),
    [
        ("--points", "1,2\n3,4\n", "no column followup_x_px"),
        ("--homography", '{"schema": "standoff.psf/1"}', "H.json"),
        ("--mask", "text", "cannot"),
        ("--points", None, "p"),
    ],
)
def test_a_hint_that_cannot_be_read_is_one_line(
    command: Command,
    photographs: tuple[Path, Path],
    tmp_path: Path,
    option: str,
    content: str | None,
    said: str,
) -> None:
    path = tmp_path / ("H.json" if option == "--homography" else "p")
    if content is not None:
        path.write_text(content)
    err = command.refused(1, "changes", *photographs, option, path, "--out", tmp_path / "out")
    assert path.name in err
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_points_of_one_photograph_are_refused_for_several(
    command: Command, photographs: tuple[Path, Path], tmp_path: Path
) -> None:
    (tmp_path / "p.csv").write_text(
        "followup_x_px,followup_y_px,reference_x_px,reference_y_px\n"
        "1,1,2,2\n9,1,18,2\n1,9,2,18\n9,9,18,18\n"
    )
    words = (*photographs, photographs[1], "--points", tmp_path / "p.csv")
    err = command.refused(2, "changes", *words, "--out", tmp_path / "out")
    assert "points are for a single follow-up" in err


def test_a_follow_up_of_something_else_is_one_line(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    for name in ("near", "far"):
        tifffile.imwrite(
            tmp_path / f"{name}.tif", rng.normal(100, 9, (120, 150)).astype(np.float32)
        )
    err = command.refused(
        1,
        *("changes", tmp_path / "near.tif", tmp_path / "far.tif"),
        *("--psf", psf_file, "--out", tmp_path / "out"),
    )
    assert "far.tif: " in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
