"""What one line says of a result's file, whatever the file holds."""

import json
from pathlib import Path

import pytest

from standoff.console.results.key_figures import MAX_RESULT_BYTES, key_figures


@pytest.mark.parametrize(
    ("kind", "document", "line"),
    [
        ("calibrate", [1, 2], ""),
        ("calibrate", {"sigma_x_px": "wide", "rho": None}, ""),
        (
            "calibrate",
            {"sigma_x_px": 0.7, "sigma_x_err_px": 0.001, "rho": 0.25, "rho_err": 0.01},
            "σx 0.7000 ± 0.0020 px, ρ 0.2500 ± 0.0196",  # 1.96 standard errors
        ),
        ("calibrate", {"sigma_y_px": 0.6}, "σy 0.6000 px"),
        (
            "noise",
            {"gain_e_per_dn": 5.0, "gain_e_per_dn_err": 0.01, "saturation_dn": 4095},
            "K 5.000 ± 0.020 e/DN, saturation 4095 DN",
        ),
        ("geometry", {"tilt_deg": 0.1, "tilt_err_deg": 0.01}, "tilt 0.100 ± 0.020°"),
        (  # the bench file's focal length, which nothing measured
            "geometry",
            {"pupil_offset_mm": 12.5, "pupil_offset_err_mm": 0.1}
            | {"focal_length_px": 963.86, "focal_length_err_px": 0.0},
            "entrance pupil 12.50 ± 0.20 mm",
        ),
        (
            "geometry",
            {"focal_length_px": 963.86, "focal_length_err_px": 1.5},
            "focal length 963.86 ± 2.94 px",
        ),
        (
            "changes",
            {"changes": [{}], "changed_px": 7, "compared_px": 100},
            "1 change: 7 of 100 pixels",
        ),
        ("changes", {"changes": 3}, ""),
        (
            "pose",
            {"is_accepted": False, "dprime_decisive": 1.5, "min_dprime": 2, "overlap": 0.5},
            "rejected: d' 1.50, threshold 2, overlap 50 %",
        ),
        (
            "validate",
            {
                "table_2": [
                    {"alignment": "followup-grid", "model": name, "ssim": ssim} | {"pairs": 3}
                    | {"psnr_db": 30.0}
                    for name, ssim in (("bicubic", 0.8), ("matched", 0.9))
                ]
            },
            "3 pairs, closest model: matched (SSIM 0.900, PSNR 30.0 dB)",
        ),
        ("validate", {"table_2": []}, ""),
    ],
)  # fmt: skip
def test_a_line_says_what_the_file_tells_and_junk_says_nothing(
    tmp_path: Path, kind: str, document: object, line: str
) -> None:
    path = tmp_path / f"{kind}.json"
    path.write_text(json.dumps(document))
    found = key_figures(kind, path)
    assert found is not None
    assert found.text == line


def test_a_file_that_is_replaced_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "psf.json"
    path.write_text('{"sigma_x_px": 0.6}')
    first = key_figures("calibrate", path)
    path.write_text('{"sigma_x_px": 0.65}')
    second = key_figures("calibrate", path)
    assert [each.text for each in (first, second) if each] == ["σx 0.6000 px", "σx 0.6500 px"]


def test_links_missing_files_and_very_large_ones_are_not_read(tmp_path: Path) -> None:
    path, elsewhere = tmp_path / "psf.json", tmp_path / "secret.json"
    assert key_figures("calibrate", path) is None
    elsewhere.write_text('{"sigma_x_px": 0.7}')
    path.symlink_to(elsewhere)
    assert key_figures("calibrate", path) is None
    path.unlink()
    path.write_text('{"sigma_x_px": 0.7}')
    with path.open("ab") as file:
        file.truncate(MAX_RESULT_BYTES + 1)
    found = key_figures("calibrate", path)
    assert found is not None
    assert found.text == ""
