"""What every document says of where it comes from."""

import hashlib
import re
from pathlib import Path
from typing import Any

from standoff import __version__


def assert_provenance(
    document: dict[str, Any], command: str, *files: Path, encoding: object = "linear"
) -> None:
    """Check version, time, command line, encoding, and that these files are listed by hash."""
    made = document["provenance"]
    assert made["version"] == __version__
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", made["created"])
    assert made["command"].startswith(f"standoff {command} ")
    assert made["encoding"] == encoding
    listed = {one["path"]: one["sha256"] for one in made["inputs"]}
    assert listed == {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
