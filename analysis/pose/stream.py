"""The verdicts on a stream of frames, counted."""

from dataclasses import dataclass, field

from analysis.pose.tracker import PoseVerdict


@dataclass(slots=True)
class StreamSummary:
    """What became of the frames; ``followed_s`` is the computing time between anchors."""

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
            self.verdicts.append({"frame": name, **verdict.to_json()})

    @property
    def frames_per_s(self) -> float | None:
        """Frames per second between anchors, computing time only; None without any."""
        followed = self.frames - self.anchors
        return followed / self.followed_s if followed else None
