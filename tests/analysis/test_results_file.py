import json
from math import inf, nan
from pathlib import Path

import pytest

from analysis.errors import ResultsFileError
from analysis.results_file import finite_or_null, write_results


def test_what_json_cannot_hold_is_null(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_results(path, finite_or_null({"psnr_db": inf, "ssim": nan, "mse_dn2": 0.0, "model": "m"}))
    expected = {"psnr_db": None, "ssim": None, "mse_dn2": 0.0, "model": "m"}
    assert json.loads(path.read_text()) == expected


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultsFileError, match=r"cannot write .*r\.json: No such file"):
        write_results(tmp_path / "nowhere" / "r.json", {})
