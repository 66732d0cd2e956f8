from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import SessionError
from acquisition.session import Photograph, Session
from calibration.errors import CalibrationError, NoEdgeError
from calibration.noise import CorrectionMaps
from calibration.psf import edge_images, edge_records, psf_of_images, scene_records
from tests.acquisition.session_fixtures import add, plan_of, writer
from tests.calibration.edge_photographs import EIGHT_NORMALS_DEG, SIGMA_X_PX, SIGMA_Y_PX
from tests.calibration.edge_session import FRAME_NOISE, FRAMES, edge_session, photograph_dn


def test_only_the_edges_of_a_session_are_read(tmp_path: Path) -> None:
    session = edge_session(tmp_path / "s")
    images = list(edge_images(session))
    assert len(session.records) == 3
    assert [image.capture for image in images] == [r.index for r in edge_records(session)]
    assert [image.name for image in images] == [r.file for r in edge_records(session)]
    assert all(image.height_mm == 100.0 for image in images)
    assert all(image.saturation_dn == 4095.0 for image in images)
    assert images[0].image_dn.dtype == np.float64


def test_the_noise_is_that_of_the_mean_from_the_temporal_variance(tmp_path: Path) -> None:
    image = next(iter(edge_images(edge_session(tmp_path / "s"))))
    assert image.noise is not None
    levels = np.array([600.0, 3000.0])
    # Nearly all of the 9900 pixels are at the two levels: sqrt(2 / 9 / 5000) = 0.7 % each.
    expected = FRAME_NOISE.variance_dn2(levels) / FRAMES
    np.testing.assert_allclose(image.noise.variance_dn2(levels), expected, rtol=0.03)
    left = image.image_dn - photograph_dn(6.0)
    assert np.std(left) == pytest.approx(np.sqrt(np.mean(expected)), rel=0.1)


@pytest.mark.slow
def test_a_session_gives_the_psf_of_its_lens(tmp_path: Path) -> None:
    psf = psf_of_images(edge_images(edge_session(tmp_path / "s", EIGHT_NORMALS_DEG)))
    x, y = psf.optical.sigma_x_px, psf.optical.sigma_y_px
    assert x is not None
    assert y is not None
    assert x.value == pytest.approx(SIGMA_X_PX, abs=4 * x.err)
    assert y.value == pytest.approx(SIGMA_Y_PX, abs=4 * y.err)
    # The noise is known independently, so the goodness of fit is given. Around 900 pixels each.
    chi2 = [edge.chi2_reduced for edge in psf.edges]
    assert all(value is not None and value == pytest.approx(1.0, abs=0.25) for value in chi2)


def test_a_single_photograph_has_no_noise_of_its_own(tmp_path: Path) -> None:
    plan = plan_of(heights_mm=[100.0], targets=[{"kind": "board", "target": "chess"}])
    with writer(tmp_path / "s", plan=plan) as session:
        image_dn = photograph_dn(6.0).astype(np.float32)
        session.add_photograph(
            session.entries[0],
            Photograph(image_dn=image_dn, pixel_format="Mono16", max_level_dn=4095.0),
        )
    [image] = edge_images(Session(tmp_path / "s"))
    assert image.noise is None
    assert psf_of_images([image]).edges[0].chi2_reduced is None


def test_a_session_without_edges_is_named(tmp_path: Path) -> None:
    session = edge_session(tmp_path / "flats", [])
    with pytest.raises(NoEdgeError) as refused:
        edge_records(session)
    assert str(session.path) in str(refused.value)
    with pytest.raises(NoEdgeError):
        next(iter(edge_images(session)))


def test_a_changed_capture_is_refused(tmp_path: Path) -> None:
    session = edge_session(tmp_path / "s")
    path = session.path / edge_records(session)[0].file
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(SessionError) as refused:
        list(edge_images(session))
    assert path.name in str(refused.value)


def scene_session(path: Path, targets: list[dict[str, object]]) -> Session:
    plan = plan_of(heights_mm=[100.0, 120.0, 160.0], targets=targets, repeats=2, order="descending")
    with writer(path, plan=plan) as session:
        for entry in session.entries:
            add(session, entry)
    return Session(path)


def test_scenes_are_the_textures_as_they_lie_from_the_nearest_on(tmp_path: Path) -> None:
    session = scene_session(
        tmp_path / "s",
        [
            {"kind": "edge", "target": "Kante"},
            {"kind": "texture", "target": "moss", "orientations_deg": [0.0, 90.0]},
            {"kind": "chart", "target": "chart", "heights_mm": [100.0]},
            {"kind": "texture", "target": "bark"},
        ],
    )
    # The edge takes places 0 to 5, two at each height, the furthest first; so go the others.
    # The chart was seen from one height alone, and of two repeats the first counts.
    assert [[record.index for record in series] for series in scene_records(session)] == [
        [10, 8, 6],
        [16, 14, 12],
        [24, 22, 20],
    ]


def test_a_session_whose_scenes_have_one_height_each_is_named(tmp_path: Path) -> None:
    session = edge_session(tmp_path / "edges")
    with pytest.raises(CalibrationError) as refused:
        scene_records(session)
    assert str(session.path) in str(refused.value)


def even_maps(shape: tuple[int, int]) -> CorrectionMaps:
    """A sensor that is half as sensitive as another everywhere, with black at 64 DN."""
    return CorrectionMaps(
        dark_dn=np.full(shape, 64.0, np.float32),
        response=np.full(shape, 0.5, np.float32),
        defects=np.zeros(shape, np.uint8),
        black_level_dn=64.0,
    )


def test_maps_of_another_camera_are_refused_with_the_capture(tmp_path: Path) -> None:
    session = edge_session(tmp_path / "s")
    file = edge_records(session)[0].file
    with pytest.raises(CalibrationError) as refused:
        next(iter(edge_images(session, correction=even_maps((90, 100)))))
    for fact in (file, "(90, 110)", "(90, 100)"):
        assert fact in str(refused.value)


def test_correction_is_taken_off_the_level_the_noise_and_not_off_what_is_clipped(
    tmp_path: Path,
) -> None:
    session = edge_session(tmp_path / "s")
    plain = next(iter(edge_images(session)))
    corrected = next(iter(edge_images(session, correction=even_maps((90, 110)))))
    np.testing.assert_allclose(corrected.image_dn, 64.0 + 2 * (plain.image_dn - 64.0), rtol=1e-6)
    # 3250 DN become 6436, above the 4095 of the format; the pixels did not clip.
    assert corrected.image_dn.max() > 4095.0
    assert corrected.clipped is not None
    assert not corrected.clipped.any()
    assert plain.noise is not None
    assert corrected.noise is not None
    levels = np.array([600.0, 3000.0])
    np.testing.assert_allclose(
        corrected.noise.variance_dn2(64.0 + 2 * (levels - 64.0)),
        4 * plain.noise.variance_dn2(levels),
        rtol=0.02,
    )
