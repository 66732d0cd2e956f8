"""``simulate --depth``: maps and lists of planes, masks, and what is refused."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

import standoff
from acquisition.photographs import read_photograph
from calibration.errors import CalibrationError
from tests.analysis.detectability.test_curves import curve
from tests.standoff.conftest import Command

ROWS, COLS = 90, 120
NEAR = (slice(30, 60), slice(40, 80))
"""A thing at half the distance of the rest, which is at 600 mm."""


@pytest.fixture
def reference(tmp_path: Path) -> Path:
    levels = np.random.default_rng(2).uniform(400, 3000, (ROWS // 3, COLS // 3))
    path = tmp_path / "near.tif"
    image = cv2.resize(levels, (COLS, ROWS), interpolation=cv2.INTER_CUBIC)
    tifffile.imwrite(path, image.astype(np.float32))
    return path


@pytest.fixture
def depth_file(tmp_path: Path) -> Path:
    depth = np.full((ROWS, COLS), 600, np.float32)
    depth[NEAR] = 300
    path = tmp_path / "depth.tif"
    tifffile.imwrite(path, depth)
    return path


def homography_file(folder: Path, shift_px: float) -> Path:
    matrix = [[1.0, 0.0, shift_px], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    path = folder / "H.json"
    document = {"schema": "standoff.homography/1", "matrix": matrix, "size": [COLS, ROWS]}
    path.write_text(json.dumps(document))
    return path


def test_a_nearer_thing_hides_what_is_behind_it(
    command: Command, reference: Path, depth_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    # The plane at 600 is shifted by 6 px; at half the depth things are shifted by 12. So the thing
    # uncovers a strip of 6 px on one side, and covers one on the other.
    out, hidden = tmp_path / "far.tif", tmp_path / "hidden.png"
    printed = command.done(
        *("simulate", reference, "--homography", homography_file(tmp_path, 6.0)),
        *("--depth", depth_file, "--focal-length-px", "500", "--psf", psf_file),
        *("--hidden", hidden, "--out", out),
    )
    assert "hidden from the reference" in printed.out
    mask = read_photograph(hidden).stored != 0
    assert np.count_nonzero(mask[45, :110]) == pytest.approx(6, abs=1)
    assert not mask[10, :110].any()
    far, near = tifffile.imread(out), tifffile.imread(reference)
    # 6 and 12 whole pixels: levels are the reference's own, blurred by nothing.
    middle = near[35:55, 50:70]
    assert far[35:55, 38:58] == pytest.approx(middle, abs=0.02 * float(np.ptp(near)))
    assert far[5:20, 20:60] == pytest.approx(near[5:20, 26:66], abs=0.02 * float(np.ptp(near)))


def test_a_list_of_planes_is_the_map_that_it_describes(
    command: Command, reference: Path, depth_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    corners = [[39.5, 29.5], [79.5, 29.5], [79.5, 59.5], [39.5, 59.5]]
    document = {
        "schema": "standoff.depth-planes/1",
        "size": [COLS, ROWS],
        "depth": 600,
        "planes": [{"outline_px": corners, "depth": [300, 300, 300, 300]}],
    }
    planes = tmp_path / "planes.json"
    planes.write_text(json.dumps(document))
    levels = []
    for number, depth in enumerate((depth_file, planes)):
        out = tmp_path / f"{number}.tif"
        command.done(
            *("simulate", reference, "--zoom", "1.5", "--depth", depth),
            *("--psf", psf_file, "--out", out),
        )
        levels.append(tifffile.imread(out))
    assert levels[1] == pytest.approx(levels[0], rel=1e-6)


def test_a_slanted_plane_has_the_depths_of_its_corners(tmp_path: Path) -> None:
    # Inverse depths are linear in the frame: half-way between 1/4 and 1/2 it is 3/8.
    path = tmp_path / "planes.json"
    outline = [[0, 0], [40, 0], [40, 30], [0, 30]]
    path.write_text(
        json.dumps(
            {
                "schema": "standoff.depth-planes/1",
                "size": [60, 50],
                "depth": 9,
                "planes": [{"outline_px": outline, "depth": [4, 2, 2, 4]}],
            }
        )
    )
    depth = standoff.read_depth(path).depth
    assert depth[10, 20] == pytest.approx(8 / 3)
    assert depth[10, 0] == pytest.approx(4.0)
    assert depth[45, 50] == 9


def test_depths_of_a_depth_camera_are_unknown_where_they_are_0(
    command: Command, reference: Path, psf_file: Path, tmp_path: Path
) -> None:
    depth = np.full((ROWS, COLS), 600, np.uint16)
    depth[40:50, 60:80] = 0
    path, hidden = tmp_path / "depth.png", tmp_path / "hidden.png"
    cv2.imwrite(str(path), depth)
    result = command.document(
        *("simulate", reference, "--zoom", "1", "--depth", path, "--psf", psf_file),
        *("--hidden", hidden, "--out", tmp_path / "far.tif"),
    )
    assert result["hidden_fraction"] == pytest.approx(200 / (ROWS * COLS))
    assert np.array_equal(read_photograph(hidden).stored != 0, depth == 0)


def test_colour_and_noise_go_through_it(depth_file: Path, psf_file: Path) -> None:
    rng = np.random.default_rng(3)
    colours = rng.uniform(500, 2500, (ROWS, COLS, 3))
    scene = standoff.read_depth(depth_file)
    far = standoff.simulate(colours, zoom=1.3, depth=scene, psf=psf_file)
    assert far.image.shape == (69, 92, 3)
    own = standoff.simulate(colours[:, :, 1], zoom=1.3, depth=scene, psf=psf_file)
    assert far.image[:, :, 1] == pytest.approx(own.image, rel=1e-5)
    noise = standoff.CaptureNoise(gain_e_per_dn=4.0, read_noise_e=12.0, black_level_dn=0.0)
    noisy = standoff.simulate(colours[:, :, 1], zoom=1.3, depth=scene, psf=psf_file, noise=noise)
    # The reference passes some of its noise on; what a capture has beyond that is added.
    passed = noisy.followup.own_variance_dn2
    assert passed is not None
    seen = own.image > 0
    added = noise.variance_dn2(own.image.astype(np.float64))[seen] - passed[seen]
    scatter = np.std((noisy.image - own.image)[seen] / np.sqrt(added))
    assert np.min(passed[seen]) > 0
    assert scatter == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--homography", "H.json"), "focal_length_px: a homography needs it"),
        (("--zoom", "2", "--model", "paper"), "--depth"),
        (("--zoom", "2", "--uncertainty", "u.tif"), "--uncertainty"),
    ],
)
def test_what_does_not_go_together_is_refused(
    command: Command,
    reference: Path,
    depth_file: Path,
    psf_file: Path,
    words: tuple[str, ...],
    message: str,
) -> None:
    folder = reference.parent
    homography_file(folder, 6.0)
    given = [folder / word if "." in word else word for word in words]
    out = folder / "far.tif"
    err = command.refused(
        2 if message.startswith("--") else 1,
        *("simulate", reference, *given, "--depth", depth_file, "--psf", psf_file, "--out", out),
    )
    assert message in err
    assert not out.exists()


def test_a_map_of_another_size_is_refused(
    command: Command, reference: Path, psf_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "small.tif"
    tifffile.imwrite(path, np.full((40, 50), 3, np.float32))
    err = command.refused(
        1,
        *("simulate", reference, "--zoom", "2", "--depth", path, "--psf", psf_file),
        *("--out", tmp_path / "far.tif"),
    )
    assert "depth map has 50 x 40 px" in err


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("d.tif", b"", "no depth map"),
        ("d.tif", b"nothing of the kind", "no depth map"),
        ("d.json", b'{"schema": "standoff.psf/1"}', "schema"),
        (
            "d.json",
            b'{"schema": "standoff.depth-planes/1", "size": [60, 50], "depth": 9, "planes": '
            b'[{"outline_px": [[0, 0], [9, 0], [9, 9], [0, 9]], "depth": [4, 2, 2, 2]}]}',
            "do not lie on a plane",
        ),
        (
            "d.json",
            b'{"schema": "standoff.depth-planes/1", "size": [60, 50], "depth": 9, "planes": '
            b'[{"outline_px": [[0, 0], [9, 0], [9, 9]], "depth": [4, 2]}]}',
            "3 corners need one depth",
        ),
        (
            "d.json",
            b'{"schema": "standoff.depth-planes/1", "size": [900000, 900000], "depth": 9}',
            "million pixels",
        ),
    ],
)
def test_a_file_that_holds_no_depth_is_named(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(CalibrationError, match=message) as caught:
        standoff.read_depth(path)
    assert name in str(caught.value)


@pytest.mark.parametrize("depth", [np.zeros((9, 9)), np.full((9, 9), -3.0)])
def test_a_map_without_depth_is_named(tmp_path: Path, depth: object) -> None:
    path = tmp_path / "d.tif"
    tifffile.imwrite(path, np.asarray(depth, dtype=np.float32))
    with pytest.raises(CalibrationError, match=r"d\.tif: expected depths above 0"):
        standoff.read_depth(path)


def test_a_coloured_depth_map_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "d.png"
    cv2.imwrite(str(path), np.full((9, 9, 3), 3, np.uint8))
    with pytest.raises(CalibrationError, match="one channel, this image 3"):
        standoff.read_depth(path)


# d' of the curve is 2 at zoom 1.5, and 1 at 2.


@pytest.fixture
def further(tmp_path: Path) -> Path:
    """The plane at 600 from 1.5 times as far; what is at half of that is then twice as far."""
    size = [COLS, ROWS]
    matrix = [
        [1.5, 0, (COLS - 1) / 2 * (1 - 1.5)],
        [0, 1.5, (ROWS - 1) / 2 * (1 - 1.5)],
        [0, 0, 1],
    ]
    path = tmp_path / "further.json"
    document = {"schema": "standoff.homography/1", "matrix": matrix, "size": size}
    path.write_text(json.dumps(document))
    return path


@pytest.fixture
def curves(tmp_path: Path) -> Path:
    path = tmp_path / "curves.json"
    one = json.loads(curve().model_dump_json())
    path.write_text(json.dumps({"schema": "standoff.detectability/1", "curves": [one]}))
    return path


def test_d_prime_is_predicted_at_each_distance(
    depth_file: Path, further: Path, curves: Path
) -> None:
    scene = standoff.read_depth(depth_file, focal_length_px=500.0)
    judged = standoff.judge_homography(further, curves, 0.9, depth=scene)
    d_prime = judged.quality.d_prime
    assert d_prime.shape == (ROWS, COLS)
    middle = ROWS // 2, COLS // 2
    assert d_prime[middle] == pytest.approx(1.0, rel=1e-3)
    assert d_prime[middle[0], 30] == pytest.approx(2.0, rel=1e-3)
    # A thing that shrinks more than its ground uncovers some of that: there is no d' there.
    hidden = judged.hidden
    assert hidden is not None
    assert 0 < hidden < 0.1
    inside = judged.quality.sampling.inside
    assert np.mean(np.isnan(d_prime[inside])) == pytest.approx(hidden, abs=1e-9)
    flat = standoff.judge_homography(further, curves, 0.9)
    assert flat.hidden is None
    assert flat.quality.summary.dprime_min == pytest.approx(2.0, rel=1e-3)
    assert judged.quality.summary.dprime_min == pytest.approx(1.0, rel=2e-2)


def test_a_flat_map_gives_the_figures_of_a_flat_scene(further: Path, curves: Path) -> None:
    flat = standoff.judge_homography(further, curves, 0.9)
    scene = standoff.SceneDepth(depth=np.full((ROWS, COLS), 3.0), focal_length_px=500.0)
    judged = standoff.judge_homography(further, curves, 0.9, depth=scene)
    assert judged.hidden == 0
    one, other = flat.to_json(), judged.to_json()
    for name in ("dprime_min", "dprime_median", "dprime_decisive", "zoom_max", "probability"):
        assert other[name] == pytest.approx(one[name], rel=1e-5)
    assert judged.is_accepted == flat.is_accepted


def test_the_command_predicts_d_prime_with_depth(
    command: Command, depth_file: Path, further: Path, curves: Path
) -> None:
    words = ("limits", "--homography", further, "--curves", curves, "--min-dprime", "1")
    shown = command.document(
        *words, "--depth", depth_file, "--focal-length-px", "500", "--plane-depth", "600"
    )
    assert shown["dprime_min"] == pytest.approx(1.0, rel=2e-2)
    assert 0 < shown["hidden"] < 0.1
    assert command.document(*words)["hidden"] is None
    said = command.done(*words, "--depth", depth_file, "--focal-length-px", "500").out
    assert "is hidden" in said
    assert "a homography needs it" in command.refused(2, *words, "--depth", depth_file)
    refused = command.refused(2, *words, "--depth", depth_file, "--geometry", "g.json")
    assert "cannot be used with --geometry" in refused
    refused = command.refused(2, *words, "--plane-depth", "600")
    assert "--depth" in refused
