"""What ImageJ itself reads from a capture: the program, without a screen, run on the file."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.session._record import CaptureRecord
from tests.acquisition.records import RECORD, capture_bytes, images

IMAGEJ_JAR = Path("/usr/share/java/ij.jar")

pytestmark = pytest.mark.skipif(
    shutil.which("xvfb-run") is None or not IMAGEJ_JAR.exists(),
    reason="ImageJ or Xvfb is not installed (Debian: imagej, xvfb, xauth)",
)

MACRO = """
open("{capture}");
getPixelSize(unit, width_unit, height_unit);
getDimensions(width, height, channels, slices, frames);
out = "" + width + " " + height + " " + slices + " " + bitDepth() + "\\n";
out = out + unit + " " + d2s(1 / width_unit, 9) + "\\n";
for (slice = 1; slice <= slices; slice++) {{
    setSlice(slice);
    out = out + getInfo("slice.label") + "\\n";
    for (y = 0; y < height; y++)
        for (x = 0; x < width; x++)
            out = out + d2s(getValue(x, y), 9) + " ";
    out = out + "\\n";
}}
File.saveString(out, "{values}");
File.saveString(getMetadata("Info"), "{info}");
"""


@pytest.mark.slow
def test_imagej_reads_the_pixels_the_scale_and_the_record(tmp_path: Path) -> None:
    record = replace(RECORD, scale_px_per_mm=12.345)
    stored = images(record)
    assert stored.variance_dn2 is not None
    capture = tmp_path / "capture.tif"
    capture.write_bytes(capture_bytes(stored))
    macro = tmp_path / "read.ijm"
    values, info = tmp_path / "values.txt", tmp_path / "info.txt"
    macro.write_text(MACRO.format(capture=capture, values=values, info=info), encoding="utf-8")
    subprocess.run(
        [
            "xvfb-run",
            "-a",
            "java",
            "-Dfile.encoding=UTF-8",
            "-jar",
            str(IMAGEJ_JAR),
            "-batch",
            str(macro),
        ],
        check=True,
        capture_output=True,
        timeout=600,
    )
    layout, scale, *pages = values.read_text(encoding="utf-8").splitlines()
    rows, cols = stored.mean_dn.shape
    assert layout == f"{cols} {rows} 2 32"
    unit, px_per_mm = scale.split()
    assert unit == "mm"
    assert float(px_per_mm) == pytest.approx(12.345, rel=1e-6)
    assert pages[0::2] == ["mean", "variance"]
    for line, page in zip(pages[1::2], (stored.mean_dn, stored.variance_dn2), strict=True):
        seen = np.array(line.split(), dtype=np.float64).reshape(page.shape)
        np.testing.assert_array_equal(seen.astype(np.float32), page)
    document = json.loads(info.read_text(encoding="utf-8"))
    assert CaptureRecord.from_json(document, source="ImageJ") == replace(record, sha256=None)
