"""The doctor's checks from inside the console, which has camera and stage open itself."""

import shutil

from acquisition.aravis import route_to
from acquisition.bench import resolve_address
from acquisition.errors import DeviceError
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import DeviceStatus
from standoff.doctor import (
    Check,
    advice_on,
    check_disk,
    check_libraries,
    check_mtu,
    check_receive_buffer,
    check_route,
    check_stage_port,
)


def bench_checks(hub: BenchHub) -> tuple[Check, ...]:
    """Run all checks; camera and stage as the console sees them, since only it may open them."""
    bench = hub.bench
    checks = [check_libraries(needed=bench.camera.driver == "aravis"), check_receive_buffer()]
    if bench.camera.driver == "aravis" and bench.camera.address is not None:
        try:
            route = route_to(resolve_address(bench.camera.address))
        except DeviceError as error:
            remedy = advice_on(error)
            checks.append(Check(name="network", status="fail", found=str(error), remedy=remedy))
        else:
            checks += [check_route(route), check_mtu(route)]
    info, settings = hub.camera.info, hub.camera.settings
    found = (
        "" if info is None else f"{info.vendor} {info.model}, serial number {info.serial_number}"
    )
    checks.append(_device("camera", hub.camera.status, found))
    if settings is not None:
        counts = hub.frames.counts
        text = (
            f"{counts.complete} complete, {counts.incomplete} incomplete, {counts.lost} lost; "
            f"{counts.rate_hz:.1f} per second"
        )
        is_good = counts.incomplete + counts.lost <= 1e-3 * max(counts.complete, 1)
        checks.append(
            Check(
                name="frames",
                status="ok" if is_good else "warn",
                found=text,
                remedy="" if is_good else "check cable, switch, packet size and receive buffer",
            )
        )
    if not hub.stage.status.is_ready:
        checks.append(check_stage_port(bench.stage))
    stage = hub.stage.view
    found = "" if stage.info is None else f"{stage.info.vendor} {stage.info.model}".strip()
    checks.append(_device("stage", stage.status, found))
    folder = hub.sessions.folder
    while not folder.exists():
        folder = folder.resolve().parent
    checks.append(check_disk(folder, lambda path: shutil.disk_usage(path).free))
    checks += [
        Check(name=name, status="warn", found=warning)
        for name, warnings in (("camera", hub.camera.warnings), ("stage", stage.warnings))
        for warning in warnings
        if "receive buffer" not in warning
    ]
    return tuple(checks)


def _device(name: str, status: DeviceStatus, found: str) -> Check:
    if status.is_ready:
        return Check(name=name, status="ok", found=found or "responding")
    level = "warn" if status.state == "opening" else "fail"
    return Check(name=name, status=level, found=status.text, remedy=status.remedy)  # type: ignore[arg-type]  # of two literals
