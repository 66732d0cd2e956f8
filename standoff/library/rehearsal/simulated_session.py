"""Runs a whole capture plan on the simulated bench, without an operator."""

from pathlib import Path

from acquisition.bench import BenchConfig
from acquisition.capture import CaptureProgress, RunOperator, run_plan
from acquisition.plan import CapturePlan, plan_entries
from standoff.errors import ApplicationError
from standoff.library.bench import devices_of, open_bench, place_in_simulation
from standoff.library.call import Call


def capture_simulated(
    call: Call, path: Path, config: BenchConfig, plan: CapturePlan, *, operator: str, what: str
) -> None:
    """Capture a session at ``path``, or what it still lacks.

    Raises
    ------
    ApplicationError
        If the bench is a real one; ``what`` names the work that needs a simulated one.
    DeviceError, SessionError
        If a capture fails; the session can be resumed.
    """
    if config.camera.driver != "simulated":  # before a real one is opened and configured
        raise ApplicationError(f"{what} runs on the simulated bench only")
    with (
        open_bench(config) as devices,
        call.bar("capturing", len(plan_entries(plan))) as advance_to,
    ):
        assert devices.simulated is not None

        def show(done: CaptureProgress) -> None:
            advance_to(done.captured)

        run_plan(
            path,
            plan,
            devices_of(devices, config),
            RunOperator(name=operator, place=place_in_simulation(devices.simulated), progress=show),
        )
