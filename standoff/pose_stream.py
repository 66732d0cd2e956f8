"""Live guidance: frames of a folder or a camera, each with a verdict on its pose."""

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from rich.live import Live
from rich.text import Text

from acquisition.live_frames import newest_frames
from analysis.pose_tracker import PoseTracker, PoseVerdict
from standoff.errors import ApplicationError, ImageFileError
from standoff.focus_runs import OpenCamera
from standoff.image_files import image_files_in, read_grey
from standoff.output import ERRORS, say

__all__ = [
    "NamedFrame",
    "PoseDisplay",
    "StreamSummary",
    "camera_frames",
    "folder_frames",
    "judge_stream",
    "verdict_facts",
]

_POLL_S = 0.2
_INTERVAL_S = 0.1
_PLAIN_INTERVAL_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class NamedFrame:
    """One image of a stream; the name is that of its file, or the frame's number."""

    name: str
    image: NDArray[np.generic]


@dataclass(slots=True)
class StreamSummary:
    """What a stream came to."""

    frames: int = 0
    accepted: int = 0
    unknown: int = 0
    anchors: int = 0
    followed_s: float = 0.0
    last: PoseVerdict | None = None
    verdicts: list[dict[str, object]] = field(default_factory=list)

    def add(self, name: str, verdict: PoseVerdict, busy_s: float, *, is_kept: bool) -> None:
        """Count a verdict; those of a folder are kept one by one."""
        self.frames += 1
        self.accepted += verdict.accepted
        self.unknown += verdict.dprime is None
        self.anchors += verdict.anchored
        if not verdict.anchored:
            self.followed_s += busy_s
        self.last = verdict
        if is_kept:
            self.verdicts.append({"frame": name, **verdict_facts(verdict)})

    @property
    def frames_per_s(self) -> float | None:
        """Frames per second between two anchors, of computing alone; None without any."""
        followed = self.frames - self.anchors
        return followed / self.followed_s if followed else None


def verdict_facts(verdict: PoseVerdict) -> dict[str, object]:
    """Content of a verdict for a JSON document."""
    return {
        "is_accepted": verdict.accepted,
        "dprime_decisive": verdict.dprime,
        "margin": verdict.margin,
        "reason": verdict.reason,
        "zoom": verdict.zoom,
        "overlap": verdict.overlap,
        "is_anchored": verdict.anchored,
        "homography": None if verdict.homography is None else verdict.homography.tolist(),
    }


def verdict_line(name: str, verdict: PoseVerdict) -> str:
    """One line for the operator: what to do, by how much, why."""
    word = "accept" if verdict.accepted else "reject" if verdict.dprime is not None else "lost"
    margin = "" if verdict.margin is None else f"{100 * verdict.margin:+6.1f} %"
    return f"{name:<12} {word:<6} {margin:>8}  {verdict.reason}"


class PoseDisplay:
    """Shows verdicts: in place on a terminal, else line by line.

    Parameters
    ----------
    is_live
        A camera's: on stderr, no faster than the eye. A folder's: every one, on stdout.
    is_silent
        Nothing is shown, as stdout belongs to a JSON document; a camera's go to stderr still.
    """

    def __init__(self, *, is_live: bool, is_silent: bool) -> None:
        self._is_live, self._is_silent = is_live, is_silent
        self._shown_s: float | None = None
        on_screen = is_live and ERRORS.is_terminal
        self._screen = Live(console=ERRORS, auto_refresh=False) if on_screen else None

    def __enter__(self) -> Self:
        if self._screen is not None:
            self._screen.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._screen is not None:
            self._screen.__exit__(kind, error, trace)

    def show(self, name: str, verdict: PoseVerdict) -> None:
        """Show a verdict."""
        line = verdict_line(name, verdict)
        if not self._is_live:
            if not self._is_silent:
                say(line)
            return
        now_s = time.monotonic()
        interval_s = _PLAIN_INTERVAL_S if self._screen is None else _INTERVAL_S
        if self._shown_s is not None and now_s - self._shown_s < interval_s:
            return
        self._shown_s = now_s
        if self._screen is None:
            ERRORS.print(line, markup=False)
        else:
            style = "bold green" if verdict.accepted else "bold red"
            self._screen.update(Text(line, style=style), refresh=True)


def judge_stream(
    frames: Iterator[NamedFrame],
    tracker: PoseTracker,
    summary: StreamSummary,
    display: PoseDisplay,
    *,
    count: int | None,
    is_kept: bool,
) -> None:
    """Judge frame after frame, until they end, ``count`` were judged or Ctrl-C.

    Raises
    ------
    ApplicationError
        If a frame is none that can be judged.
    """
    with display:
        for frame in frames:
            begin_s = time.perf_counter()
            try:
                verdict = tracker.update(frame.image)
            except ValueError as error:
                raise ApplicationError(f"{frame.name}: {error}") from error
            summary.add(frame.name, verdict, time.perf_counter() - begin_s, is_kept=is_kept)
            display.show(frame.name, verdict)
            if summary.frames == count:
                return


@contextmanager
def camera_frames(opened: OpenCamera) -> Iterator[Iterator[NamedFrame]]:
    """Frames of a camera, always the newest one; the stream ends with the block."""
    with closing(newest_frames(opened.camera)) as frames:
        yield (NamedFrame(f"frame {frame.frame_id}", frame.image_dn) for frame in frames)


def folder_frames(folder: Path, *, is_watched: bool) -> Iterator[NamedFrame]:
    """Images of a folder in the order of their names; then, if watched, those that come.

    Raises
    ------
    ImageFileError
        If an image cannot be read. In a watched folder one that is not whole yet is waited for,
        until it no longer grows.
    ApplicationError
        If the folder holds no image and is not watched.
    """
    seen: set[Path] = set()
    sizes: dict[Path, int] = {}
    while True:
        files = [path for path in image_files_in(folder) if path not in seen]
        if not files and not seen and not is_watched:
            raise ApplicationError(f"{folder}: the folder holds no image")
        for path in files:
            size = path.stat().st_size if path.exists() else 0
            try:
                image = read_grey(path)
            except ImageFileError:
                if is_watched and sizes.get(path) != size:
                    sizes[path] = size
                    continue
                raise
            seen.add(path)
            yield NamedFrame(path.name, image)
        if not is_watched:
            return
        time.sleep(_POLL_S)
