"""A user's own files may have the names of our packages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import standoff
from standoff.shadowing import HiddenPackageError, refuse_hidden_packages

CHECKOUT = Path(standoff.__file__).parents[1]


def run_there(folder: Path, *words: object, paths: tuple[Path, ...] = ()) -> tuple[int, str, str]:
    """Status and streams of a command that is started in ``folder``."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (*paths, CHECKOUT)))}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def hide(folder: Path, name: str) -> Path:
    """Write something of the user's that goes by the name of one of our packages."""
    if name.endswith(".py"):
        path = folder / name
    else:
        (folder / name).mkdir()
        path = folder / name / "__init__.py"
    path.write_text("raise SystemExit('the file of the user was imported')\n")
    return folder / name


@pytest.mark.parametrize("name", ["analysis.py", "simulation"])
def test_a_file_in_the_working_folder_that_hides_a_package_is_named_in_one_line(
    tmp_path: Path, name: str
) -> None:
    hiding = hide(tmp_path, name)
    status, out, err = run_there(tmp_path, sys.executable, "-m", "standoff", "verify", ".")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert str(hiding) in err


def test_the_library_names_the_file_that_hides_a_package(tmp_path: Path) -> None:
    hiding = hide(tmp_path, "analysis.py")
    words = ("-c", "import standoff; standoff.read_psf")
    status, out, err = run_there(tmp_path, sys.executable, *words)
    assert (status, out) == (1, "")
    assert err.splitlines()[-1].startswith("standoff.shadowing.HiddenPackageError: ")
    assert str(hiding) in err.splitlines()[-1]


def test_a_hidden_package_is_named_where_the_search_path_leads_to_the_other_one(
    tmp_path: Path,
) -> None:
    hiding = hide(tmp_path, "calibration")
    (tmp_path / "work").mkdir()
    words = (sys.executable, "-m", "standoff", "--version")
    status, _, err = run_there(tmp_path / "work", *words, paths=(tmp_path,))
    assert (status, err.count("\n")) == (1, 1)
    assert str(hiding) in err


def test_a_folder_of_data_hides_nothing(tmp_path: Path) -> None:
    (tmp_path / "simulation").mkdir()
    (tmp_path / "analysis").mkdir()
    (tmp_path / "analysis" / "notes.txt").write_text("of mine")
    status, out, _ = run_there(tmp_path, sys.executable, "-m", "standoff", "--version")
    assert (status, out) == (0, f"standoff {standoff.__version__}\n")


def test_the_installed_command_does_not_look_into_the_working_folder(tmp_path: Path) -> None:
    hide(tmp_path, "analysis.py")
    script = Path(sys.executable).with_name("standoff")
    status, out, _ = run_there(tmp_path, script, "--version")
    assert (status, out) == (0, f"standoff {standoff.__version__}\n")


def test_the_error_holds_the_package_and_what_hides_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_hidden_packages()
    hiding = hide(tmp_path, "acquisition.py")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "acquisition", raising=False)
    with pytest.raises(HiddenPackageError) as refused:
        refuse_hidden_packages()
    assert refused.value.name == "acquisition"
    assert refused.value.path == str(hiding)
