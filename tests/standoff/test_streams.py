"""What is printed where an encoding is poor, the reader gone, the disk full, a stream closed."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from standoff.streams import as_shown

ASCII = (
    {"PYTHONIOENCODING": "ascii"},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": ""},
)
WIDTHS = {"sigma_x_px": 0.8, "sigma_x_err_px": 0.002, "sigma_y_px": 0.7, "sigma_y_err_px": 0.002}


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Two calibrations of names that ASCII lacks."""
    paths = tmp_path / "März.json", tmp_path / "九月.json"
    for number, path in enumerate(paths):
        content = {"schema": "standoff.psf/1", **WIDTHS, "sigma_x_px": 0.8 + 0.1 * number}
        path.write_text(json.dumps(content), encoding="utf-8")
    return paths


def ended(
    words: tuple[object, ...], redirected: str = "", environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run a command line in a shell, which redirects its streams."""
    line = f'"$0" -m standoff "$@" {redirected}'
    return subprocess.run(
        ["/bin/bash", "-o", "pipefail", "-c", line, sys.executable, *map(str, words)],
        capture_output=True,
        env=os.environ | (environment or {}),
        check=False,
    )


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("0.80 ± 0.02 µm", "0.80 +/- 0.02 um"),
        ("3.1 px², 10⁻¹² m, 2³", "3.1 px^2, 10^-12 m, 2^3"),
        ("95.0°, 2 – 3 × 4, Δσ ≤ 1 → 2 …", "95.0 deg, 2 - 3 x 4, Deltasigma <= 1 -> 2 ..."),
        ("│ ━╇┓ ███·", "| -++ ###."),
        ("März 九月 \udcff \U0001f600", "M\\xe4rz \\u4e5d\\u6708 \\udcff \\U0001f600"),
    ],
)
def test_what_ascii_lacks_is_spelt_out_and_other_letters_are_escaped(text: str, shown: str) -> None:
    assert as_shown(text, "ascii") == shown


def test_what_the_encoding_has_stays_as_it_is() -> None:
    assert as_shown("1 ± 2 px², März", "utf-8") == "1 ± 2 px², März"
    assert as_shown("1 ± 2 px², März → 九", "latin-1") == "1 ± 2 px², März -> \\u4e5d"


@pytest.mark.slow
@pytest.mark.parametrize("environment", ASCII, ids=["ascii", "C"])
def test_a_table_on_an_ascii_terminal_is_ascii_in_straight_columns(
    files: tuple[Path, Path], environment: dict[str, str]
) -> None:
    done = ended(("compare", *files), "2>&1", environment)
    lines = done.stdout.decode("ascii").splitlines()
    assert (done.returncode, lines[0].strip()) == (0, "PSF, +/- at 95 %")
    (row,) = [line for line in lines if "sigma_x_px" in line and "|" in line]
    assert "0.8000 +/- 0.0039" in row
    table = [line for line in lines if line[:1] in "|+"]
    assert len({len(line) for line in table}) == 1
    assert "the PSF has changed" in lines[-1]


@pytest.mark.slow
@pytest.mark.parametrize("environment", ASCII, ids=["ascii", "C"])
def test_json_and_help_and_errors_on_an_ascii_terminal_are_ascii(
    files: tuple[Path, Path], environment: dict[str, str]
) -> None:
    done = ended(("compare", *files, "--json"), environment=environment)
    document = json.loads(done.stdout.decode("ascii"))
    assert document["is_changed"] is True
    if "LC_ALL" not in environment:  # under which the name on the command line is bytes, not text
        assert document["second"] == str(files[1])
    done = ended(("compare", files[0], files[1].with_name("九.json")), environment=environment)
    assert (done.returncode, done.stdout) == (1, b"")
    assert done.stderr.decode("ascii").count("\n") == 1
    shown = ended(("changes", "--help"), environment=environment).stdout.decode("ascii")
    assert "+- Options" in shown
    assert "--psf" in shown


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("more", [("--json",), ()], ids=["json", "table"])
def test_a_full_disk_under_the_output_is_one_line(
    files: tuple[Path, Path], more: tuple[str, ...]
) -> None:
    done = ended(("compare", *files, *more), "> /dev/full")
    assert done.returncode == 1
    assert done.stderr == b"standoff: cannot write to standard output: No space left on device\n"


@pytest.mark.slow
def test_a_reader_that_has_seen_enough_ends_the_command_without_a_word(
    files: tuple[Path, Path],
) -> None:
    for more in ((), ("--json",), ("--help",)):
        done = ended(("compare", *files, *more), "| true")
        assert (done.returncode, done.stdout, done.stderr) == (1, b"", b"")


@pytest.mark.slow
def test_a_closed_stream_ends_no_work_and_takes_the_place_of_no_file(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    report = tmp_path / "history.html"
    words = ("compare", "--history", *files, "--report", report, "--force")
    for redirected in (">&-", ">/dev/null 2>&-", ">&- 2>&- <&-", ">/dev/null 2>/dev/full"):
        done = ended(words, redirected)
        assert (done.returncode, done.stderr) == (0, b""), redirected
        assert report.read_text("utf-8").startswith("<!doctype html>"), redirected
        report.unlink()
