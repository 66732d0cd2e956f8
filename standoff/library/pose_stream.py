"""Live guidance: frames from a folder or a camera, each with a verdict on its pose."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.bench import BenchConfig
from acquisition.focus import newest_frames
from acquisition.photographs import Inputs, ReadOptions, image_files_in
from analysis.choices import Criterion
from analysis.pose import PoseTracker, PoseVerdict, StreamSummary
from calibration.errors import CalibrationError
from simulation.arguments import checked
from simulation.arrays import AnyArray
from standoff.errors import ApplicationError, ImageFileError
from standoff.library.bench import bench_config, opened_camera, place_target
from standoff.library.call import Call, FilePath, ImageLike, Progress, Silent, path_of
from standoff.library.detectability import CurveChoice, CurveLike, given_curve

_POLL_S = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class NamedFrame:
    """One image of a stream, named after its file or its frame number."""

    name: str
    image: AnyArray


class PoseWatch:
    """Judges the pose of one frame after another.

    ``run`` judges frames until they end; ``summary`` can be read at any time.

    Parameters
    ----------
    reference
        The earlier, nearer photograph: an array or a file.
    curve, min_d_prime, choice, criterion, focus_scatter_px2
        As in ``judge_pose``.
    reading
        How files are read; see ``standoff.reading``.

    Raises
    ------
    ArgumentError
        If not exactly one curve is selected, or the threshold is not positive.
    CalibrationError
        If the reference has too few features.

    Examples
    --------
    >>> watch = standoff.PoseWatch("before.tif", "curves.json", 2)
    >>> frames = watch.folder("after")
    >>> summary = watch.run(frames, lambda name, verdict: print(name, verdict.accepted))
    day-1.tif True
    day-2.tif True
    >>> summary.frames
    2
    """

    @checked
    def __init__(
        self,
        reference: ImageLike,
        curve: CurveLike,
        min_d_prime: float,
        *,
        choice: CurveChoice | None = None,
        criterion: Criterion = "min",
        focus_scatter_px2: float | None = None,
        reading: ReadOptions | None = None,
    ) -> None:
        self._call = Call("PoseWatch", None, reading, (curve,))
        self.curve = given_curve(curve, min_d_prime, choice, focus_scatter_px2)
        self.min_d_prime, self.criterion = min_d_prime, criterion
        self.summary = StreamSummary()
        near = self._call.photograph(reference, "reference")
        try:
            self._tracker = PoseTracker(near.grey_dn, self.curve, min_d_prime, criterion)
        except (CalibrationError, ValueError) as error:
            raise CalibrationError(f"{near.path}: {error}") from error

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on how the photographs were read."""
        return self._call.notes

    @checked
    def run(
        self,
        frames: Iterable[NamedFrame],
        show: Callable[[str, PoseVerdict], None] = lambda _name, _verdict: None,
        *,
        count: int | None = None,
        is_kept: bool = True,
    ) -> StreamSummary:
        """Judge one frame after another, until they end or ``count`` frames have been judged.

        Parameters
        ----------
        frames
            Frames from `folder` or `camera`, or of one's own.
        show
            Called with the name and the verdict of each frame.
        count
            Number of frames in all after which to end; None for no limit.
        is_kept
            Whether the summary keeps every verdict.

        Raises
        ------
        ApplicationError
            If a frame cannot be judged.
        """
        for frame in frames:
            begin_s = time.perf_counter()
            try:
                verdict = self._tracker.update(frame.image)
            except ValueError as error:
                raise ApplicationError(f"{frame.name}: {error}") from error
            busy_s = time.perf_counter() - begin_s
            self.summary.add(frame.name, verdict, busy_s, is_kept=is_kept)
            show(frame.name, verdict)
            if self.summary.frames == count:
                break
        return self.summary

    @checked
    def folder(self, path: FilePath, *, is_watched: bool = False) -> Iterator[NamedFrame]:
        """Yield the images of a folder and, with ``is_watched``, new ones as they are added."""
        return _folder_frames(path_of(path, "path"), self._call.inputs, is_watched=is_watched)

    @checked
    @contextmanager
    def camera(
        self,
        bench: BenchConfig | FilePath,
        *,
        settings: Mapping[str, Any] | None = None,
        target: str | None = None,
        progress: Progress | None = None,
    ) -> Iterator[Iterator[NamedFrame]]:
        """Open the camera of a bench, and give the block an iterator over its newest frames.

        Parameters
        ----------
        bench, settings
            The path of a bench file or a `BenchConfig`, and values that override keys of the file.
        target
            Name of a target to place under a simulated camera.
        progress
            Shows the progress of the call, see `Progress`; by default nothing is shown.

        Raises
        ------
        ArgumentError
            If the target cannot be placed.
        BenchConfigError, DeviceError
            If the bench or the camera is at fault.
        """
        with opened_camera(bench_config(bench, settings)) as opened:
            for remark in opened.warnings:
                self._call.announce(remark)
                (progress or Silent()).note(remark)
            place_target(opened.simulated, target)
            with closing(newest_frames(opened.camera)) as frames:
                yield (NamedFrame(f"frame {frame.frame_id}", frame.image_dn) for frame in frames)

    def to_json(self) -> dict[str, Any]:
        """Return the verdicts as ``standoff pose --json`` prints them."""
        summary = self.summary
        return {
            "criterion": self.criterion,
            "min_dprime": self.min_d_prime,
            "curve": self.curve.choice.model_dump(),
            "is_upper_bound": True,
            "provenance": self._call.provenance().model_dump(mode="json"),
            "frames": summary.frames,
            "accepted": summary.accepted,
            "lost": summary.unknown,
            "anchors": summary.anchors,
            "frames_per_s": summary.frames_per_s,
            "last": None if summary.last is None else summary.last.to_json(),
            "verdicts": summary.verdicts,
        }


def _folder_frames(folder: Path, inputs: Inputs, *, is_watched: bool) -> Iterator[NamedFrame]:
    """Yield the images of a folder by name; then, if it is watched, new ones as they come."""
    seen: set[Path] = set()
    sizes: dict[Path, int] = {}
    while True:
        files = [path for path in image_files_in(folder) if path not in seen]
        if not files and not seen and not is_watched:
            raise ApplicationError(f"{folder}: the folder contains no image")
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
