"""What people call the lens, the camera, the target and the customer, for the report of a PSF."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

from acquisition.bench import LabelsConfig, OpticsConfig, load_bench
from acquisition.printable import on_one_line
from acquisition.session import Session
from simulation.arguments import ArgumentError, ArgumentTypeError, kind_of
from standoff.library.inputs import FilePath, path_of
from standoff.library.psf.edge_sources import Reading

LABELS = tuple(LabelsConfig.model_fields)
_LONGEST = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Named:
    """The labels, None without any, and the optics of a bench file that was given."""

    labels: dict[str, str] | None = None
    optics: OpticsConfig | None = None

    def stating_pitch(self, reading: Reading) -> Reading:
        """Return how edges are read, with the bench file's pixel pitch if none is given."""
        if self.optics is None or reading.pixel_pitch_um is not None:
            return reading
        pitch_um = self.optics.pixel_pitch_um
        return replace(reading, pixel_pitch_um=pitch_um, pixel_pitch_from="the bench file")


def named_by(
    labels: Mapping[str, str] | None, bench: FilePath | None, session: Session | None
) -> Named:
    """Return the labels that are given, and those of a bench file or of a session's.

    Raises
    ------
    ArgumentError
        If one is no label, or no text.
    ConfigError
        If the bench file cannot be read.
    """
    given = _checked(labels or {})
    optics, found = None, {}
    if bench is not None:
        config = load_bench(Path(path_of(bench, "bench")))
        optics = config.optics
        found = {"lens": optics.lens} | (config.labels.model_dump() if config.labels else {})
    elif session is not None:
        known = (session.bench or {}).get("labels")
        found = known if isinstance(known, dict) else {}
    of_bench = {name: text for name, text in found.items() if name in LABELS and text}
    merged = of_bench | given
    return Named(
        labels={name: merged[name] for name in LABELS if name in merged} or None, optics=optics
    )


def _checked(labels: Mapping[str, str]) -> dict[str, str]:
    found = {}
    for name, text in labels.items():
        if name not in LABELS:
            near = get_close_matches(str(name), LABELS, n=1)
            meant = f"; {near[0]} was probably meant" if near else ""
            raise ArgumentError(
                f"expected {', '.join(LABELS[:-1])} or {LABELS[-1]}, got {name!r}{meant}",
                argument="labels",
            )
        if not isinstance(text, str):
            raise ArgumentTypeError(f"{name} is a text, not {kind_of(text)}", argument="labels")
        said = on_one_line(text).strip()
        if not said or len(said) > _LONGEST:
            raise ArgumentError(
                f"{name} is a text of 1 to {_LONGEST} letters, got {len(said)}", argument="labels"
            )
        found[name] = said
    return found
