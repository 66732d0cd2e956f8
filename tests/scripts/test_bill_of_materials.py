"""The bill of materials, held against what CycloneDX 1.6 requires of a document."""

import json
import re
import tomllib
from collections.abc import Mapping
from importlib.metadata import Distribution
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from packaging.markers import Marker, default_environment
from packaging.requirements import Requirement

from scripts import bill_of_materials
from scripts.bill_of_materials import NotTheLockError, bill, edges, installed, locked_here
from scripts.requirements_file import Locked, read, read_all
from tests.scripts.test_licences import Told

ROOT = Path(__file__).parent.parent.parent
HERE = {key: str(value) for key, value in default_environment().items()} | {"extra": ""}

# From the JSON schema of CycloneDX 1.6: `required` of each object that the bill has, the allowed
# values of `type`, and the forms of a hash and a serial number.
SERIAL_NUMBER = re.compile(r"urn:uuid:[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}")
REQUIRED = {
    "document": {"bomFormat", "specVersion"},
    "component": {"type", "name"},
    "external reference": {"url", "type"},
    "hash": {"alg", "content"},
    "dependency": {"ref"},
}
HASH = re.compile(
    r"[a-fA-F0-9]{32}|[a-fA-F0-9]{40}|[a-fA-F0-9]{64}|[a-fA-F0-9]{96}|[a-fA-F0-9]{128}"
)


class Requiring(Told):
    """With `requires` from the metadata, as an installed distribution has it."""

    def __init__(self, told: Told) -> None:
        self.message = told.message

    @property
    def requires(self) -> list[str]:
        return self.message.get_all("Requires-Dist") or []


class Version(Told):
    """A package of a version."""

    def __init__(self, name: str, version: str) -> None:
        super().__init__(name)
        self.message.replace_header("Version", version)


def ours(**fields: str | list[str]) -> Told:
    return Told("standoff", License_Expression="MIT", **fields)


def locked(name: str) -> Locked:
    return Locked(requirement=Requirement(f"{name}==1.0"), hashes=("sha256:" + 64 * "a",))


def lines_of(packages: Mapping[str, Distribution]) -> dict[str, Locked]:
    """The locked lines of the installed packages."""
    lines = {str(one.name): one for one in read_all() if one.name in packages}
    if "torch" in lines:
        build = "torch-cpu" if "+" in packages["torch"].version else "torch"
        (lines["torch"],) = read(build)
    return lines


def of_this_environment() -> dict[str, Any]:
    """The bill of the locked packages that are installed, below the project as it is today."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asks = list(project["dependencies"])
    for extra, requirements in project["optional-dependencies"].items():
        for needs in map(Requirement, requirements):
            marker = f"({needs.marker}) and " if needs.marker else ""
            needs.marker = Marker(f'{marker}extra == "{extra}"')
            asks.append(str(needs))
    told = ours(Requires_Dist=asks, Provides_Extra=list(project["optional-dependencies"]))
    packages = installed() | {"standoff": Requiring(told)}
    return bill(packages, lines_of(packages))


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    made: dict[str, Any] = json.loads(json.dumps(of_this_environment()))
    return made


@pytest.mark.slow
def test_the_document_has_what_the_schema_requires(document: dict[str, Any]) -> None:
    assert REQUIRED["document"] <= set(document)
    assert document["bomFormat"] == "CycloneDX"
    assert document["specVersion"] == "1.6"
    assert isinstance(document["version"], int)
    assert document["version"] >= 1
    assert SERIAL_NUMBER.fullmatch(document["serialNumber"])
    components = [document["metadata"]["component"], *document["components"]]
    for one in components:
        assert REQUIRED["component"] <= set(one)
        assert one["type"] in {"application", "library"}
        for reference in one.get("externalReferences", []):
            assert REQUIRED["external reference"] <= set(reference)
            assert reference["type"] == "distribution"
            for entry in reference["hashes"]:
                assert REQUIRED["hash"] == set(entry)
                assert entry["alg"] == "SHA-256"
                assert HASH.fullmatch(entry["content"])
        for licence in one.get("licenses", []):
            # One expression, or licences with a name or an SPDX identifier.
            assert set(licence) in ({"expression"}, {"license"})
    references = [one["bom-ref"] for one in components]
    assert len(set(references)) == len(references)
    for one in document["dependencies"]:
        assert REQUIRED["dependency"] <= set(one)
        assert {one["ref"], *one["dependsOn"]} <= set(references)
        assert len(set(one["dependsOn"])) == len(one["dependsOn"])


def test_every_package_is_there_with_version_licence_and_every_hash(
    document: dict[str, Any],
) -> None:
    packages = installed()
    lines = lines_of(packages)
    found = {one["name"]: one for one in document["components"]}
    assert set(found) == set(lines)
    assert len(found) > 100
    for name, line in lines.items():
        assert found[name]["version"] == packages[name].version
        assert found[name]["licenses"]
        (reference,) = found[name]["externalReferences"]
        assert {f"sha256:{one['content']}" for one in reference["hashes"]} == set(line.hashes)


def test_everything_is_reached_from_the_project_but_what_builds_it(
    document: dict[str, Any],
) -> None:
    below = {one["ref"]: one["dependsOn"] for one in document["dependencies"]}
    reached, waiting = set[str](), [document["metadata"]["component"]["bom-ref"]]
    while waiting:
        reference = waiting.pop()
        if reference not in reached:
            reached.add(reference)
            waiting += below[reference]
    builds = {str(one.name) for one in read("build")}
    missed = {one["name"] for one in document["components"] if one["bom-ref"] not in reached}
    assert missed <= builds


def test_the_same_environment_gives_the_same_bytes_and_another_another_number() -> None:
    packages = {"standoff": ours(), "lens": Told("lens", License_Expression="MIT")}
    one = bill(packages, {"lens": locked("lens")})
    assert one == bill(packages, {"lens": locked("lens")})
    other = bill({**packages, "lens": Told("lens", License="BSD")}, {"lens": locked("lens")})
    assert UUID(one["serialNumber"]) != UUID(other["serialNumber"])


def test_an_extra_of_a_package_is_followed_where_somebody_asks_for_it() -> None:
    packages = {
        "standoff": ours(
            Requires_Dist=["camera[raw]", 'lens; extra == "far"'], Provides_Extra=["far"]
        ),
        "camera": Told("camera", Requires_Dist=['sensor; extra == "raw"', 'flash; extra == "lit"']),
        "sensor": Told("sensor"),
        "flash": Told("flash"),
        "lens": Told("lens"),
    }
    found = edges({name: Requiring(one) for name, one in packages.items()}, {"far"})
    assert found["standoff"] == ["camera", "lens"]
    assert found["camera"] == ["sensor"]


@pytest.mark.slow
def test_an_environment_that_is_not_the_lock_has_no_bill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (cpu,) = read("torch-cpu")
    # Some packages are locked at one version for older Pythons and at another for newer ones.
    ours_last = sorted([*read_all(), cpu], key=lambda one: one.is_for(HERE))
    complete = {str(one.name): one for one in ours_last}
    packages = {name: Version(name, one.version) for name, one in complete.items()}
    here = {name: one for name, one in packages.items() if name in locked_names_here(packages)}
    assert set(locked_here({**here, "standoff": ours()})) == set(here)
    assert locked_here({**here, "standoff": ours()})["torch"].version.endswith("+cpu")
    of_the_index = Version("torch", here["torch"].version.removesuffix("+cpu"))
    assert locked_here({**here, "torch": of_the_index})["torch"].version == of_the_index.version

    for wrong, told in (
        ({**here, "lens": Version("lens", "1.0")}, "lens 1.0 is not in the lock"),
        ({**here, "numpy": Version("numpy", "1.0")}, "numpy is 1.0, in the lock"),
        ({name: one for name, one in here.items() if name != "scipy"}, "scipy"),
    ):
        with pytest.raises(NotTheLockError, match=re.escape(told)):
            locked_here(wrong)

    monkeypatch.setattr(bill_of_materials, "installed", lambda: {"lens": Version("lens", "1.0")})
    out = tmp_path / "sbom.json"
    assert bill_of_materials.main(["--out", str(out)]) == 1
    assert "make clean setup" in capsys.readouterr().err
    assert not out.exists()


def locked_names_here(packages: dict[str, Version]) -> set[str]:
    """What the lock has for this machine with a torch that needs no GPU."""
    try:
        return set(locked_here({"torch": packages["torch"]}))
    except NotTheLockError as error:
        return {"torch", *re.findall(r"(\S+) \S+ is not installed", str(error))}
