from pathlib import Path

import pytest

from calibration.errors import LimitsFileError
from calibration.sharpness import read_limits
from standoff.shipped_configs import shipped_config


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    return path


def test_limits_are_read_in_the_order_of_the_tables(tmp_path: Path) -> None:
    limits = read_limits(
        written(tmp_path, "[sigma]\nmax_px = 0.9\n[mtf50]\ncorner_min_lw_per_ph = 800\n")
    )
    assert list(limits.given()) == [("mtf50.corner_min_lw_per_ph", 800.0), ("sigma.max_px", 0.9)]
    assert limits.zones.centre_radius == 0.3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[mtf50]\nmin_cypx = 0.2\n", "unknown key mtf50.min_cypx"),
        ("[mtf50]\nmin_cy_per_pixel = 1\n", "did you mean mtf50.min_cy_per_px?"),
        ("[sigmas]\nmax_px = 1\n", "unknown key sigmas"),
        ("[mtf50]\nmin_cy_per_px = 0\n", "mtf50.min_cy_per_px"),
        ("[mtf50]\nmin_cy_per_px = nan\n", "mtf50.min_cy_per_px"),
        ('[mtf50]\nmin_cy_per_px = "0,2"\n', "0.2"),
        ("[mtf50]\nmin_cy_per_px = 0,2\n", "line 2"),
        ("[uniformity]\ncorner_to_centre_min = 70\n", "uniformity.corner_to_centre_min"),
        ("[zones]\ncentre_radius = 0.8\ncorner_radius = 0.7\n", "must not exceed corner_radius"),
        ("[zones]\ncentre_radius = 0.2\n", "it sets no limit; set one"),
        ("", "it sets no limit; set one"),
        ("[mtf50", "not valid TOML"),
    ],
)
def test_a_file_at_fault_is_refused_by_the_name_of_the_key(
    tmp_path: Path, text: str, message: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(LimitsFileError) as refused:
        read_limits(path)
    assert str(path) in str(refused.value)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LimitsFileError, match=r"none\.toml: No such file"):
        read_limits(tmp_path / "none.toml")


def test_the_shipped_example_is_read() -> None:
    keys = [key for key, _ in read_limits(shipped_config("limits.toml")).given()]
    assert "mtf50.centre_min_cy_per_px" in keys
    assert "lateral_colour.max_px" in keys
