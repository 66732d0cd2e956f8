"""The environment of a measurement: processor, system, versions; no date, no machine name."""

import os
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

CPU_INFO = Path("/proc/cpuinfo")


def environment(packages: Iterable[str] = ()) -> dict[str, str]:
    """Processor, cores, system, Python and the versions of ``packages``."""
    facts = {
        "processor": processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
    }
    return facts | {name: version(name) for name in packages}


def environment_line(facts: dict[str, str]) -> str:
    """Write the facts in one line of text."""
    named = {key: value for key, value in facts.items() if key not in ("processor", "cores")}
    system = named.pop("system")
    versions = ", ".join(f"{name} {number}" for name, number in named.items())
    return f"{facts['processor']}, {facts['cores']} cores, {system}; {versions}"


def processor() -> str:
    """Name of the processor's model where the system tells it."""
    if CPU_INFO.exists():
        for line in CPU_INFO.read_text().splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()
