"""OME-Zarr 0.5: opened by zarr, and judged by yaozarrs, which knows the specification."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.session_export import write_export
from tests.acquisition.session_export.sessions import (
    exported_session,
    request_of,
    scale_at,
)

zarr = pytest.importorskip("zarr", reason="needs standoff[export]")
yaozarrs = pytest.importorskip("yaozarrs", reason="needs yaozarrs, a judge of the tests")


def test_every_capture_is_a_valid_image_at_its_height(tmp_path: Path) -> None:
    session = exported_session(tmp_path / "session")
    out = tmp_path / "session.ome.zarr"
    write_export(session, request_of("ome-zarr", out))
    yaozarrs.validate_zarr_store(str(out))
    root = zarr.open_group(out, mode="r")
    assert list(root["OME"].attrs["ome"]["series"]) == ["0", "1", "2", "3", "4"]
    for name, record in zip("01234", session.records, strict=True):
        yaozarrs.validate_zarr_store(str(out / name))
        images = session.load(record)
        assert images.variance_dn2 is not None
        planes = np.asarray(root[name]["0"][...])
        assert planes.shape == (2, 1, *images.mean_dn.shape)
        assert np.array_equal(planes[0, 0], images.mean_dn)
        assert np.array_equal(planes[1, 0], images.variance_dn2)
        (multiscale,) = root[name].attrs["ome"]["multiscales"]
        units = {axis["name"]: axis.get("unit") for axis in multiscale["axes"]}
        assert units == {"c": None, "z": "millimeter", "y": "millimeter", "x": "millimeter"}
        scale, translation = multiscale["datasets"][0]["coordinateTransformations"]
        pixel_mm = 1 / scale_at(record.height_mm)
        assert scale["scale"] == pytest.approx([1, 1, pixel_mm, pixel_mm], rel=1e-12)
        assert translation["translation"] == [0, record.height_mm, 0, 0]
        assert root[name].attrs["standoff"]["capture"]["sha256"] == record.sha256
    assert root.attrs["standoff"]["provenance"]["inputs"][0]["sha256"] == "ab" * 32


def test_the_ome_xml_beside_the_images_meets_its_schema(tmp_path: Path) -> None:
    ome_types = pytest.importorskip("ome_types", reason="needs ome-types, a judge of the tests")
    session = exported_session(tmp_path / "session")
    out = tmp_path / "session.ome.zarr"
    write_export(session, request_of("ome-zarr", out))
    text = (out / "OME" / "METADATA.ome.xml").read_text("utf-8")
    ome_types.validate_xml(text)
    heights = [image.pixels.planes[0].position_z for image in ome_types.from_xml(text).images]
    assert heights == [record.height_mm for record in session.records]
