"""OME-TIFF: opened by tifffile, its metadata by ome-types, and held against the official schema."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from acquisition.session_export import write_export
from tests.acquisition.session_export.sessions import (
    exported_session,
    photographed_session,
    request_of,
    scale_at,
)

ome_types = pytest.importorskip("ome_types", reason="needs ome-types, a judge of the tests")


def written(path: Path) -> Any:
    """The metadata as ome-types reads them, after the official schema has been met."""
    with tifffile.TiffFile(path) as file:
        assert file.is_ome
        text = file.ome_metadata
    assert text is not None
    ome_types.validate_xml(text)
    return ome_types.from_xml(text)


def test_every_capture_is_an_image_of_mean_and_variance(tmp_path: Path) -> None:
    session = exported_session(tmp_path / "session")
    out = tmp_path / "session.ome.tif"
    write_export(session, request_of("ome-tiff", out))
    records = session.records
    with tifffile.TiffFile(out) as file:
        assert len(file.series) == len(records) == 5
        for series, record in zip(file.series, records, strict=True):
            images = session.load(record)
            assert series.axes == "CYX"
            mean_dn, variance_dn2 = series.asarray()
            assert np.array_equal(mean_dn, images.mean_dn)
            assert images.variance_dn2 is not None
            assert np.array_equal(variance_dn2, images.variance_dn2)


def test_the_fields_of_the_model_hold_what_the_session_knows(tmp_path: Path) -> None:
    session = exported_session(tmp_path / "session")
    out = tmp_path / "session.ome.tif"
    write_export(session, request_of("ome-tiff", out))
    ome = written(out)
    annotations = {each.id: each for each in ome.structured_annotations}
    for image, record in zip(ome.images, session.records, strict=True):
        pixels = image.pixels
        assert [channel.name for channel in pixels.channels] == ["mean", "variance"]
        assert (pixels.physical_size_x_unit.value, pixels.physical_size_y_unit.value) == (
            "mm",
            "mm",
        )
        assert pixels.physical_size_x == pytest.approx(1 / scale_at(record.height_mm), rel=1e-12)
        for plane in pixels.planes:
            assert (plane.position_z, plane.position_z_unit.value) == (record.height_mm, "mm")
            assert (plane.exposure_time, plane.exposure_time_unit.value) == (2000.0, "µs")
        settings = pixels.channels[0].detector_settings
        assert (settings.gain, settings.offset, settings.integration) == (0.0, 64.0, 3)
        assert image.stage_label.z == record.height_mm
        assert image.acquisition_date.isoformat().startswith(record.started_utc[:19])
        facts = {
            key: value
            for reference in image.annotation_refs
            for key, value in annotations[reference.id].value.items()
        }
        assert facts["sha256"] == record.sha256
        assert facts["command"] == "standoff export session"
        assert facts["inputs.0.sha256"] == "ab" * 32
        assert facts["uid"] in (record.uid, session.manifest.uid)
    assert ome.experimenters[0].user_name == "Zoë"
    assert ome.instruments[0].detectors[0].serial_number == "C1"


def test_a_scale_that_nobody_knows_is_left_out(tmp_path: Path) -> None:
    session = photographed_session(tmp_path / "session")
    out = tmp_path / "session.ome.tif"
    done = write_export(session, request_of("ome-tiff", out, with_scale=False))
    assert (done.captures, done.with_scale) == (2, 1)
    first, second = written(out).images
    assert first.pixels.physical_size_x == pytest.approx(1 / 12.5)
    assert second.pixels.physical_size_x is None
    assert second.pixels.planes[0].exposure_time is None
    with tifffile.TiffFile(out) as file:
        assert [series.shape for series in file.series] == [(4, 6), (5, 7)]
