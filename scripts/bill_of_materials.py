"""Write the bill of materials of the environment, as CycloneDX 1.6 in JSON.

    make sbom

Every package that the lock has for this machine, with its version, licence, what it depends on and
the SHA-256 of each file that set-up would have taken. An environment that is not what the lock says
has no bill. The same environment gives the same bytes: there is no time and no random number in it.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import uuid
from collections.abc import Mapping, Sequence
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from scripts.licences import licence_of
from scripts.requirements_file import STEPS, Locked, read
from scripts.torch_build import needs_cuda

PROJECT = "standoff"
NOT_OURS = frozenset({"pip"})  # comes with Python's venv

# A licence expression: SPDX identifiers and LicenseRef-s joined by operators.
_SPDX = re.compile(r"[A-Za-z0-9.+-]+( (AND|OR|WITH) [A-Za-z0-9.+-]+)*")


class NotTheLockError(Exception):
    """What is installed is not what the lock says."""


def _purl(name: str, version: str) -> str:
    """The package URL of a Python package."""
    return f"pkg:pypi/{name}@{version.replace('+', '%2B')}"


def installed() -> dict[str, Distribution]:
    """What this interpreter finds, by normalised name; the first on its path."""
    found: dict[str, Distribution] = {}
    for package in distributions():
        found.setdefault(str(canonicalize_name(package.metadata["Name"])), package)
    return found


def locked_here(packages: Mapping[str, Distribution]) -> dict[str, Locked]:
    """The lines of the lock that hold on this machine, by name.

    NotTheLockError if a package is missing, of another version or not in the lock.
    """
    environment = {key: str(value) for key, value in default_environment().items()} | {"extra": ""}
    torch = packages.get("torch")
    is_cpu = torch is not None and Version(torch.version).local is not None
    left_out = {"torch" if is_cpu else "torch-cpu"}
    if torch is None or not needs_cuda(torch.requires or []):
        left_out.add("cuda")
    steps = [step for step in STEPS if step not in left_out]
    lines = {str(one.name): one for step in steps for one in read(step) if one.is_for(environment)}
    wrong = [
        f"{name} {line.version} is not installed"
        for name, line in lines.items()
        if name not in packages
    ]
    for name, package in packages.items():
        if name in NOT_OURS or name == PROJECT:
            continue
        if name not in lines:
            wrong.append(f"{name} {package.version} is not in the lock")
        elif Version(package.version) != Version(lines[name].version):
            wrong.append(f"{name} is {package.version}, in the lock {lines[name].version}")
    if wrong:
        raise NotTheLockError(
            f"the environment is not what requirements/ says: {'; '.join(sorted(wrong))}: "
            "make one that is with make clean setup"
        )
    return lines


def edges(packages: Mapping[str, Distribution], extras: set[str]) -> dict[str, list[str]]:
    """What each package asks for, with the extras that others ask it for; ``extras`` of ours."""
    asked: dict[str, set[str]] = {name: {""} for name in packages}
    asked[PROJECT] |= extras
    found: dict[str, set[str]] = {name: set() for name in packages}
    changed = True
    while changed:
        changed = False
        for name, package in packages.items():
            for text in package.requires or []:
                needs = Requirement(text)
                other = str(canonicalize_name(needs.name))
                holds = needs.marker is None or any(
                    needs.marker.evaluate({"extra": extra}) for extra in asked[name]
                )
                if not holds or other not in packages:
                    continue
                if other not in found[name] or not needs.extras <= asked[other]:
                    found[name].add(other)
                    asked[other] |= needs.extras
                    changed = True
    return {name: sorted(others) for name, others in found.items()}


def _component(package: Distribution, line: Locked | None) -> dict[str, Any]:
    """One package; without ``line`` it is the project itself."""
    name = str(canonicalize_name(package.metadata["Name"]))
    reference = _purl(name, package.version)
    licence = licence_of(package)
    made: dict[str, Any] = {
        "type": "library" if line else "application",
        "bom-ref": reference,
        "name": name,
        "version": package.version,
        "purl": reference,
    }
    if licence:
        spdx = _SPDX.fullmatch(licence.replace("(", "").replace(")", ""))
        made["licenses"] = [{"expression": licence} if spdx else {"license": {"name": licence}}]
    if line:
        made["externalReferences"] = [
            {
                "type": "distribution",
                "url": _purl(name, line.version),
                "comment": "the wheels and the source of this version: set-up takes no other file",
                "hashes": [
                    {"alg": "SHA-256", "content": text.removeprefix("sha256:")}
                    for text in line.hashes
                ],
            }
        ]
    return made


def bill(packages: Mapping[str, Distribution], lines: Mapping[str, Locked]) -> dict[str, Any]:
    """The document."""
    ours = packages[PROJECT]
    kept = {name: packages[name] for name in [*lines, PROJECT]}
    asks = edges(kept, set(ours.metadata.get_all("Provides-Extra") or []))
    references = {name: _purl(name, package.version) for name, package in kept.items()}
    document: dict[str, Any] = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": _component(ours, None)},
        "components": [_component(packages[name], lines[name]) for name in sorted(lines)],
        "dependencies": [
            {"ref": references[name], "dependsOn": [references[other] for other in asks[name]]}
            for name in sorted(kept)
        ],
    }
    content = json.dumps(document, sort_keys=True)
    return {"serialNumber": uuid.uuid5(uuid.NAMESPACE_OID, content).urn} | document


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the bill; the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    out: Path = parser.parse_args(arguments).out
    packages = installed()
    try:
        lines = locked_here(packages)
    except NotTheLockError as error:
        print(error, file=sys.stderr)
        return 1
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(bill(packages, lines), indent=1) + "\n", encoding="utf-8")
    print(f"{out}: {len(lines)} packages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
