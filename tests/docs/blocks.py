"""Code blocks of a page, run in order in one folder, and what the page says they print.

A block of ``sh`` or ``python`` is run; a block of ``text`` after it is what it prints. A comment
before a block says what a person does meanwhile:
``<!-- run: interrupted once PATH has 5 lines -->`` (Ctrl-C, status 130),
``<!-- run: until the end of the page, ready at WORDS -->`` (a second terminal),
``<!-- run: ends with status 1 -->``.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
LONGEST_S = 300.0
"""For one block; all of a tutorial takes a tenth of it."""

_BLOCK = re.compile(
    r"(?:<!-- run: (?P<how>.*?) -->\n)?```(?P<language>sh|python|text)\n(?P<code>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)


class DoesNotRunError(AssertionError):
    """A block of a page ended otherwise than the page says, or printed something else."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """Some lines that a reader types, and the lines that the page shows after them."""

    language: str
    code: str
    how: str
    shown: str
    line: int


def blocks(page: str) -> list[Block]:
    """The blocks of ``page`` that are run, in order."""
    found: list[Block] = []
    for match in _BLOCK.finditer(page):
        code = match["code"]
        if match["language"] != "text":
            line = page.count("\n", 0, match.start("code"))
            how = match["how"] or "ends with status 0"
            found.append(Block(language=match["language"], code=code, how=how, shown="", line=line))
        elif found and not found[-1].shown:
            last = found.pop()
            found.append(
                Block(
                    language=last.language,
                    code=last.code,
                    how=last.how,
                    shown=code,
                    line=last.line,
                )
            )
    return found


@dataclass(kw_only=True)
class Terminal:
    """A shell in ``folder``, where ``cd`` lasts, and the processes behind it."""

    folder: Path
    in_background: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def run(self, block: Block) -> str:
        """Run ``block`` and return what it printed, on both streams in their order.

        Raises
        ------
        DoesNotRunError
            If it ended in another way than the page says.
        """
        output = self.folder.parent / f"printed-{block.line}.txt"
        with output.open("wb") as stream:
            process = subprocess.Popen(
                self._command(block),
                cwd=self.folder,
                env=_environment(),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        expected = self._wait(block, process, output)
        printed = output.read_text("utf-8")
        if process.returncode != expected:
            raise DoesNotRunError(
                f"line {block.line}: status {process.returncode}, not {expected}\n{printed}"
            )
        state = self.folder.parent / "folder.txt"
        if state.is_file():
            self.folder = Path(state.read_text("utf-8").strip())
            state.unlink()
        return printed

    def _command(self, block: Block) -> list[str]:
        if block.language == "python":
            return [sys.executable, "-c", block.code]
        keep = f'\npwd > "{self.folder.parent / "folder.txt"}"\n' if " cd " in block.code else ""
        # As at a prompt, Ctrl-C ends the command, and the shell sees its status.
        return ["sh", "-e", "-c", "trap : INT\n" + block.code + keep]

    def _wait(self, block: Block, process: subprocess.Popen[bytes], output: Path) -> int | None:
        """Wait as the page says; return the status that is expected, None while it runs."""
        if of_file := re.fullmatch(r"interrupted once (\S+) has (\d+) lines", block.how):
            path, lines = self.folder / of_file[1], int(of_file[2])
            _until(lambda: path.is_file() and path.read_bytes().count(b"\n") >= lines, process)
            os.killpg(process.pid, signal.SIGINT)
            process.wait(LONGEST_S)
            return 130
        if words := re.fullmatch(r"until the end of the page, ready at (.+)", block.how):
            self.in_background.append(process)
            _until(lambda: words[1] in output.read_text("utf-8"), process)
            return None
        status = re.fullmatch(r"ends with status (\d+)", block.how)
        assert status is not None, f"line {block.line}: not known: {block.how}"
        process.wait(LONGEST_S)
        return int(status[1])


def _until(is_so: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    ends = time.monotonic() + LONGEST_S
    while not is_so() and process.poll() is None and time.monotonic() < ends:
        time.sleep(0.01)


@contextmanager
def terminal(folder: Path) -> Iterator[Terminal]:
    """A terminal in ``folder``; what still runs behind it at the end is interrupted."""
    opened = Terminal(folder=folder)
    try:
        yield opened
    finally:
        for process in opened.in_background:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            process.wait(LONGEST_S)


def _environment() -> dict[str, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    mine = {"PATH": path, "PYTHONPATH": str(CHECKOUT), "COLUMNS": "160", "NO_COLOR": "1"}
    return os.environ | mine | {"PYTHONUNBUFFERED": "1"}
