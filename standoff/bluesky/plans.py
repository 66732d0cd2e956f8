"""A scan of heights as a plan of Bluesky."""

from collections.abc import Generator
from typing import TYPE_CHECKING, Any

from acquisition.plan import plan_entries
from standoff.bluesky.camera import SessionCamera
from standoff.bluesky.stage import HeightStage
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from bluesky.utils import Msg


def height_scan(
    stage: HeightStage, camera: SessionCamera, *, md: dict[str, Any] | None = None
) -> "Generator[Msg, Any, Any]":
    """Visit every height that the camera's session still lacks, with an event for each capture.

    Every height is checked against the travel before anything moves. Run again after an
    interrupt or an error, it resumes the session.

    Parameters
    ----------
    stage, camera
        Of one bench.
    md
        Metadata for the run's start document.

    Raises
    ------
    ApplicationError
        If Bluesky is not installed.
    StageLimitError
        If a height is outside the travel.
    """
    try:
        from bluesky import plan_stubs, preprocessors
    except ImportError as error:
        raise ApplicationError(
            f'a scan needs Bluesky ({error}): pip install "standoff[bluesky]"'
        ) from error
    for entry in plan_entries(camera.plan):
        stage.check_value(entry.height_mm)

    def scan() -> "Generator[Msg, Any, Any]":
        heights_mm = camera.pending_heights_mm()
        facts = {
            "plan_name": "height_scan",
            "detectors": [camera.name],
            "motors": [stage.name],
            "num_points": len(heights_mm),
            "hints": {"dimensions": [(stage.hints["fields"], "primary")]},
            "standoff_plan": camera.plan.to_json(),
            "standoff_session": str(camera.out.absolute()),
        }

        def visit() -> "Generator[Msg, Any, Any]":
            for height_mm in heights_mm:
                yield from plan_stubs.checkpoint()
                yield from plan_stubs.mv(stage, height_mm)
                yield from plan_stubs.trigger_and_read([camera, stage])

        return (yield from preprocessors.run_wrapper(visit(), md={**facts, **(md or {})}))

    return (yield from preprocessors.stage_wrapper(scan(), [camera]))
