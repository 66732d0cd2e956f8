"""What an installation holds: our names are ours, the extras and entry points are there."""

import importlib
import re
import tomllib
import zipfile
from importlib.metadata import distribution, packages_distributions
from pathlib import Path

import pytest

import standoff
from acquisition.bench import load_bench
from acquisition.plan import load_plan
from calibration.sharpness import read_limits
from scripts.try_wheel import LARGEST_WHEEL_BYTES, build_wheel, pythons

ROOT = Path(__file__).parent.parent
PACKAGES = ("acquisition", "calibration", "simulation", "analysis", "hil_mocks", "standoff")


@pytest.mark.parametrize("name", PACKAGES)
def test_our_common_names_are_imported_from_this_checkout(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__file__ is not None
    assert Path(module.__file__).parent == ROOT / name


@pytest.mark.slow
@pytest.mark.parametrize("name", PACKAGES)
def test_no_other_distribution_ships_our_names(name: str) -> None:
    owners = set(packages_distributions().get(name, []))
    assert owners <= {"standoff"}


@pytest.mark.parametrize("name", PACKAGES)
def test_every_package_is_typed_and_says_what_it_is(name: str) -> None:
    assert (ROOT / name / "py.typed").is_file()
    assert importlib.import_module(name).__doc__


@pytest.mark.slow
def test_the_wheel_holds_every_module_config_template_and_photograph(tmp_path: Path) -> None:
    wheel = build_wheel(tmp_path)
    assert wheel.stat().st_size < LARGEST_WHEEL_BYTES
    with zipfile.ZipFile(wheel) as archive:
        held = {name: archive.getinfo(name).file_size for name in archive.namelist()}
    wanted = {
        path.relative_to(ROOT): path.stat().st_size
        for name in PACKAGES
        for path in (ROOT / name).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    wanted |= {
        Path("standoff", path.relative_to(ROOT)): path.stat().st_size
        for path in (ROOT / "configs").iterdir()
    }
    shipped = {Path(name): size for name, size in held.items() if ".dist-info/" not in name}
    assert shipped == wanted
    photographs = {path.name for path in shipped if path.parent.name == "example_photographs"}
    assert photographs == {
        *("nearer.png", "further.png", "LICENSE"),
        *("lantern-before.jpg", "lantern-after.jpg", "LICENSE.lantern"),
        "README.md",
    }


def test_the_wheel_is_tried_on_every_python_that_it_is_for() -> None:
    assert pythons() == ("3.11", "3.12", "3.13")


def test_the_version_is_told_once() -> None:
    assert distribution("standoff").version == standoff.__version__


def test_the_extras_are_those_of_the_guide() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(project["optional-dependencies"]) == {
        "aravis",
        "kernelgan",
        "learned",
        "console",
        "cluster",
        "pdf",
        "raw",
        "formats",
        "onnx",
        "bluesky",
        "pandas",
        "s3",
        "gs",
        "parquet",
        "export",
        "docs",
        "dev",
    }
    assert "Private :: Do Not Upload" in project["classifiers"]


def test_the_citation_is_of_this_version() -> None:
    # Checked against the schema of version 1.2.0 with cffconvert.
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    told = dict(re.findall(r"^([a-z-]+): (.+)$", text, re.MULTILINE))
    assert told["cff-version"] == "1.2.0"
    assert told["version"] == standoff.__version__
    assert told["license"] == "MIT"
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (\S+)$", changes, re.MULTILINE)[0] == standoff.__version__


def test_newer_pygobject_is_kept_out() -> None:
    # From 3.52 on it needs girepository-2.0, which Debian 12 does not have.
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (requirement,) = project["optional-dependencies"]["aravis"]
    assert "<3.52" in requirement


@pytest.mark.parametrize(
    "folder", sorted({path.parent for path in (ROOT / "tests").rglob("test_*.py")})
)
def test_every_test_folder_is_a_package(folder: Path) -> None:
    # Without it, tests/acquisition would shadow acquisition.
    assert (folder / "__init__.py").is_file()


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.toml")), ids=lambda p: p.name)
def test_every_shipped_config_loads(path: Path) -> None:
    table = tomllib.loads(path.read_text())
    if path.stem == "limits":
        assert any(read_limits(path).given())
    elif "schema" in table:
        assert load_plan(path).name
    else:
        assert load_bench(path).camera.driver
