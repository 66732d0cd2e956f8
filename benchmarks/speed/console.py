"""The console under two viewers: pictures a second, latency, lost frames, processor, memory.

Run with ``python -m benchmarks.speed.console [--seconds S]``; 600 is the figure in docs/console.md.
The practice bench, the console and Chromium are processes of their own, all on this machine. The
peer is the same console in the same run without a viewer. Latency is from the arrival of a frame
at the console to its pixels being put on the page's canvas.
"""

import os
import re
import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from playwright.sync_api import Page

from benchmarks.harness import Recorder, benchmark
from tests.standoff.console.console_rig import (
    ConsoleRig,
    console_rig,
    take_control,
    text,
    wait_until,
)

SECONDS = 40.0
ALONE_S = 20.0
SAMPLE_S = 10.0
WHOLE_FRAME = ("simulated.width_px=780", "simulated.height_px=580")
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
HEAP_MB = "performance.memory.usedJSHeapSize / 1e6"
FIGURES = """() => {
  const { picture } = window.standoff;
  const sorted = [...picture.latencies].sort((one, other) => one - other);
  return [picture.drawn, sorted[sorted.length >> 1], sorted.at(-1)];
}"""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Process:
    """One process: resident memory in MB and processor seconds."""

    memory_mb: float
    processor_s: float


def process_of(pid: int) -> _Process:
    """Ask the kernel."""
    status = Path(f"/proc/{pid}/status").read_text()
    match = re.search(r"VmRSS:\s+(\d+) kB", status)
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return _Process(
        memory_mb=int(match[1]) / 1e3 if match else 0.0,
        processor_s=(int(fields[11]) + int(fields[12])) / TICKS_PER_S,
    )


def _pids_of(word: str, *, parent: int) -> list[int]:
    """Processes below ``parent`` whose command line has this word."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        children.setdefault(int(fields[1]), []).append(int(folder.name))
    found, waiting = [], [parent]
    while waiting:
        pid = waiting.pop()
        waiting += children.get(pid, [])
        try:
            line = Path(f"/proc/{pid}/cmdline").read_bytes().decode("utf-8", "replace")
        except OSError:
            continue
        if word in re.split("[\0 ]", line):
            found.append(pid)
    return found


def _lost_so_far(rig: ConsoleRig) -> tuple[int, int]:
    """Frames that were lost or incomplete, and all, by the doctor page: it shows no picture."""
    with rig.page("/doctor") as page:
        match = re.search(r"(\d+) complete, (\d+) incomplete, (\d+) lost", text(page, "main"))
    assert match is not None
    complete, incomplete, lost = (int(figure) for figure in match.groups())
    return incomplete + lost, complete + incomplete + lost


def _lost_frames(page: Page) -> tuple[int, int]:
    """Frames that were lost or incomplete, and all that the camera sent."""
    lost, all_ = text(page, "#frames-lost").split(" of ")
    return int(lost), int(all_)


def _begin_measuring(rig: ConsoleRig, page: Page) -> None:
    """Draw a region over an edge, and watch the four corners as well."""
    rig.tell_mock("place edge 5")
    take_control(page)
    bounds = page.locator("#picture").bounding_box()
    assert bounds is not None
    for share, act in ((0.4, page.mouse.down), (0.6, page.mouse.up)):
        page.mouse.move(
            bounds["x"] + share * bounds["width"], bounds["y"] + share * bounds["height"]
        )
        act()
    page.check("#watch-field")
    wait_until(lambda: page.is_visible("#edge"), "an edge is measured")


def _measure(record: Recorder, rig: ConsoleRig, seconds: float) -> None:
    (console,) = _pids_of("console", parent=os.getpid())
    time.sleep(3)
    lost_at_first, all_at_first = _lost_so_far(rig)
    began, alone_begin_s = process_of(console), time.monotonic()
    time.sleep(ALONE_S)
    alone_s = process_of(console).processor_s - began.processor_s
    alone = alone_s / (time.monotonic() - alone_begin_s)
    lost, all_ = _lost_so_far(rig)
    record.say(f"                  {lost - lost_at_first} of {all_ - all_at_first} frames lost")
    with rig.page() as one, rig.page() as other:
        pages = (one, other)
        _begin_measuring(rig, one)
        time.sleep(5)
        renderers = _pids_of("--type=renderer", parent=os.getpid())
        lost_before, all_before = _lost_frames(one)
        drawn_before = [page.evaluate(FIGURES)[0] for page in pages]
        begin_s, processor_s = time.monotonic(), process_of(console).processor_s
        latencies: list[float] = []
        worst: list[float] = []
        measured: list[float] = []
        memory: list[tuple[float, float, float, float]] = []
        while (now_s := time.monotonic() - begin_s) < seconds:
            time.sleep(min(SAMPLE_S, seconds - now_s) if seconds > now_s else 0)
            for page in pages:
                _, median_ms, worst_ms = page.evaluate(FIGURES)
                latencies.append(median_ms)
                worst.append(worst_ms)
                page.evaluate("typeof gc === 'function' && gc()")
            note = text(one, "#edge-note")
            rate = re.search(r"([\d.]+)/s", note)
            if rate is None:
                raise RuntimeError(f"the edge's note tells no rate: {note}")
            measured.append(float(rate[1]))
            memory.append(
                (
                    time.monotonic() - begin_s,
                    process_of(console).memory_mb,
                    max(process_of(pid).memory_mb for pid in renderers),
                    max(float(page.evaluate(HEAP_MB)) for page in pages),
                )
            )
            record.say(
                "  {:5.0f} s: console {:.1f} MB, page {:.1f} MB, heap {:.1f} MB".format(*memory[-1])
            )
        span_s = time.monotonic() - begin_s
        used_s = process_of(console).processor_s - processor_s
        rates = [
            (page.evaluate(FIGURES)[0] - before) / span_s
            for page, before in zip(pages, drawn_before, strict=True)
        ]
        lost_after, all_after = _lost_frames(one)
        record.say(f"pictures/s        {rates[0]:5.1f} and {rates[1]:5.1f}")
        record.say(f"worst latency of a second, median: {statistics.median(worst):.1f} ms")
        record.say(f"frames lost       {lost_after - lost_before} of {all_after - all_before}")
        record.figure("measurements of edge and corners", statistics.median(measured), "1/s")
        record.figure("latency of a picture, median", statistics.median(latencies), "ms")
        record.figure("pictures a second for each of two viewers", min(rates), "1/s")
        record.figure(
            "console with two viewers",
            100 * used_s / span_s,
            "% of a core",
            "without a viewer",
            100 * alone,
        )
        half = len(memory) // 2 or 1
        for name, place in (("console", 1), ("page", 2), ("heap", 3)):
            early = statistics.mean(row[place] for row in memory[:half])
            late = statistics.mean(row[place] for row in memory[half:] or memory)
            record.say(
                f"memory {name:10} {memory[0][place]:6.1f} MB at first, second half minus first "
                f"half {late - early:+.1f} MB"
            )


@benchmark("starlette", "uvicorn", note="780 x 580 px, two pages")
def main(
    record: Recorder, *, seconds: Annotated[float | None, "seconds with two viewers, 40"] = None
) -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        console_rig(Path(folder), mock_keys=WHOLE_FRAME) as rig,
    ):
        record.say(f"load {os.getloadavg()[0]:.1f}")
        _measure(record, rig, seconds or record.pick(SECONDS, 15.0))
        record.say(f"load {os.getloadavg()[0]:.1f}")
