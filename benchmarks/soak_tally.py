"""What happened in a soak, over several runs of it, and its page."""

import json
from collections import Counter
from dataclasses import dataclass, field, fields
from pathlib import Path

from benchmarks.environment import environment, environment_line


@dataclass(frozen=True, slots=True, kw_only=True)
class Holdings:
    """What this process holds."""

    memory_mb: float
    threads: int
    files: int

    @classmethod
    def now(cls) -> "Holdings":
        """Ask the kernel."""
        status = Path("/proc/self/status").read_text().splitlines()
        memory_kb = next(line.split()[1] for line in status if line.startswith("VmRSS"))
        return cls(
            memory_mb=int(memory_kb) / 1024,
            threads=len(list(Path("/proc/self/task").iterdir())),
            files=len(list(Path("/proc/self/fd").iterdir())),
        )


@dataclass(slots=True, kw_only=True)
class Tally:
    """What happened; ``holdings`` are those of the last run, after each session."""

    runs: int = 0
    minutes: float = 0.0
    captures: int = 0
    sessions: int = 0
    lost: int = 0
    wrong: int = 0
    unfinished: int = 0
    largest_deviation: float = 0.0
    unlocked: int = 0
    killed: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    ended_runs: Counter[str] = field(default_factory=Counter)
    holdings: list[Holdings] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> "Tally":
        """Read what earlier runs have added up; nothing if there is no file."""
        if not path.exists():
            return cls()
        made = cls(**json.loads(path.read_text(encoding="utf-8")))
        made.faults, made.ended_runs = Counter(made.faults), Counter(made.ended_runs)
        return made

    def write(self, path: Path) -> None:
        """Write it for the next run."""
        document = {one.name: getattr(self, one.name) for one in fields(self)}
        del document["holdings"]
        part = path.with_name(path.name + ".part")
        part.write_text(json.dumps(document, indent=1), encoding="utf-8")
        part.replace(path)

    def page(self) -> str:
        """What happened as Markdown."""
        # The first sessions load and compile what is not loaded yet.
        first = len(self.holdings) // 4
        settled = self.holdings[first:] or self.holdings
        rows = [
            ("resident memory / MB", [h.memory_mb for h in settled]),
            ("threads", [float(h.threads) for h in settled]),
            ("open files", [float(h.files) for h in settled]),
        ]
        lines = [
            "# Soak",
            "",
            "Made by `python -m benchmarks.soak --tally SOAK.json --page docs/soak.md`, run after "
            "run; what it does is described in `benchmarks/soak.py`.",
            "",
            f"{environment_line(environment(('numpy', 'PyGObject', 'pyserial')))}.",
            "",
            f"In **{self.minutes:.0f} minutes** ({self.runs} runs): {self.sessions} sessions, "
            f"{self.captures} captures, **{self.lost} lost, {self.wrong} wrong**; "
            f"{sum(self.faults.values())} faults, which ended {sum(self.ended_runs.values())} "
            f"captures, and {self.killed} kills of the capturing process. Each was resumed by the "
            f"same command, {self.unlocked} after `stage unlock`. Faults that the drivers "
            f"corrected themselves ended none. After 40 runs {self.unfinished} sessions were not "
            "complete yet.",
            "",
            "Every capture was compared with the scene at its height: the rms of its pixels "
            f"was at most {self.largest_deviation:.3f} times their noise.",
            "",
            "| fault | times |",
            "| --- | ---: |",
            *(f"| {name} | {count} |" for name, count in sorted(self.faults.items())),
            "",
            "| error that ended a run | times |",
            "| --- | ---: |",
            *(f"| `{name}` | {count} |" for name, count in sorted(self.ended_runs.items())),
            "",
            f"Of the capturing process in the last run, after each session from number {first + 1} "
            "on:",
            "",
            "| | first | last | least | most |",
            "| --- | ---: | ---: | ---: | ---: |",
            *(
                f"| {name} | {v[0]:.0f} | {v[-1]:.0f} | {min(v):.0f} | {max(v):.0f} |"
                for name, v in rows
                if v
            ),
        ]
        return "\n".join(lines) + "\n"
