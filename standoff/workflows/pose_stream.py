"""Live guidance: frames from a folder or a camera, each with a verdict on its pose."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.focus import newest_frames
from analysis.pose import PoseTracker, PoseVerdict
from simulation.arrays import AnyArray
from standoff.errors import ApplicationError, ImageFileError
from standoff.photographs import Inputs
from standoff.terminal import LiveLine, say
from standoff.workflows.focus_runs import OpenCamera
from standoff.workflows.image_files import image_files_in

_POLL_S = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class NamedFrame:
    """One image of a stream, named after its file or its frame number."""

    name: str
    image: AnyArray


@dataclass(slots=True)
class StreamSummary:
    """Summary of a stream."""

    frames: int = 0
    accepted: int = 0
    unknown: int = 0
    anchors: int = 0
    followed_s: float = 0.0
    last: PoseVerdict | None = None
    verdicts: list[dict[str, object]] = field(default_factory=list)

    def add(self, name: str, verdict: PoseVerdict, busy_s: float, *, is_kept: bool) -> None:
        """Count a verdict, and keep it if ``is_kept``."""
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
        """Frames per second between anchors, computing time only; None without any."""
        followed = self.frames - self.anchors
        return followed / self.followed_s if followed else None


def verdict_facts(verdict: PoseVerdict) -> dict[str, object]:
    """A verdict for a JSON document."""
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
    """One line for the operator: verdict, margin and reason."""
    word = "accept" if verdict.accepted else "reject" if verdict.dprime is not None else "lost"
    margin = "" if verdict.margin is None else f"{100 * verdict.margin:+6.1f} %"
    return f"{name:<12} {word:<6} {margin:>8}  {verdict.reason}"


@contextmanager
def verdict_display(
    *, is_live: bool, is_silent: bool
) -> Iterator[Callable[[str, PoseVerdict], None]]:
    """Yield a callback that shows a verdict of a stream, given the frame's name and the verdict.

    Parameters
    ----------
    is_live
        A camera's verdicts go to stderr, no faster than the eye; a folder's all go to stdout.
    is_silent
        Show nothing on stdout, which is for a JSON document; a camera's still go to stderr.
    """
    if is_live:
        with LiveLine(time.monotonic) as line:
            yield lambda name, verdict: line.show(
                verdict_line(name, verdict), "bold green" if verdict.accepted else "bold red"
            )
    elif is_silent:
        yield lambda name, verdict: None
    else:
        yield lambda name, verdict: say(verdict_line(name, verdict))


def judge_stream(
    frames: Iterator[NamedFrame],
    tracker: PoseTracker,
    summary: StreamSummary,
    show: Callable[[str, PoseVerdict], None],
    *,
    count: int | None,
    is_kept: bool,
) -> None:
    """Judge frame after frame, until they end, ``count`` are judged or Ctrl-C.

    Raises
    ------
    ApplicationError
        If a frame cannot be judged.
    """
    for frame in frames:
        begin_s = time.perf_counter()
        try:
            verdict = tracker.update(frame.image)
        except ValueError as error:
            raise ApplicationError(f"{frame.name}: {error}") from error
        summary.add(frame.name, verdict, time.perf_counter() - begin_s, is_kept=is_kept)
        show(frame.name, verdict)
        if summary.frames == count:
            return


@contextmanager
def camera_frames(opened: OpenCamera) -> Iterator[Iterator[NamedFrame]]:
    """Yield frames of a camera, always the newest; the stream ends with the block."""
    with closing(newest_frames(opened.camera)) as frames:
        yield (NamedFrame(f"frame {frame.frame_id}", frame.image_dn) for frame in frames)


def folder_frames(folder: Path, inputs: Inputs, *, is_watched: bool) -> Iterator[NamedFrame]:
    """Yield the images of a folder by name; then, if it is watched, new ones as they come.

    Raises
    ------
    ImageFileError
        If an image cannot be read. In a watched folder, an incomplete image is waited for until
        it no longer grows.
    ApplicationError
        If the folder cannot be read, or holds no image and is not watched.
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
                image = inputs.grey(path)
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
