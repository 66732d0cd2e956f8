"""A detector that is a command line: photographs as files, its answer as a file."""

import re
import tempfile
from pathlib import Path

import numpy as np

from acquisition.photographs import tiff_bytes
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import TiffDamageError, parse_json, read_tiff
from analysis.detectors.answers import plain_answer, short_line
from analysis.detectors.own_process import OwnProcess, how_it_ended, which_said
from analysis.detectors.spec import PLACEHOLDERS, DetectorSpec, command_words
from analysis.errors import DetectorError
from calibration.files import write_homography
from calibration.registration import Homography
from simulation.arrays import Float32Array, FloatArray

_PLACEHOLDER = re.compile("|".join(map(re.escape, PLACEHOLDERS)))
_TIFF_MAGIC = (b"II", b"MM")


class CommandHost:
    """Runs a command for every pair, without a shell, in the folder where it was named.

    Its files lie in a temporary folder of their own: both photographs as float32 TIFF, the
    homography as an H.json, and ``{out}``, which ends in ``.tif`` and may also hold a JSON number.

    Parameters
    ----------
    spec
        A command line.
    timeout_s
        For each run; then the command and the processes of its group are killed.
    """

    def __init__(self, spec: DetectorSpec, timeout_s: float) -> None:
        self._words = command_words(spec.text)
        self._folder = spec.folder
        self._timeout_s = timeout_s

    @property
    def takes_colour(self) -> bool:
        """False: nothing says it of a command."""
        return False

    def start(self) -> None:
        """Do nothing: each pair has its own process."""

    def renew(self) -> None:
        """Do nothing, either."""

    def close(self) -> None:
        """Do nothing: everything has ended with its pair."""

    def answer(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> float | Float32Array:
        """Return what the command says.

        Raises
        ------
        DetectorError
            If it fails; the message lacks the detector's name.
        """
        with tempfile.TemporaryDirectory(
            prefix="standoff-detector-", ignore_cleanup_errors=True
        ) as name:
            folder = Path(name)
            files = {
                "{reference}": folder / "reference.tif",
                "{followup}": folder / "followup.tif",
                "{homography}": folder / "homography.json",
                "{out}": folder / "out.tif",
            }
            for mark, image in (("{reference}", reference), ("{followup}", followup)):
                files[mark].write_bytes(tiff_bytes(image, f"standoff evaluate: {mark[1:-1]}"))
            size = followup.shape[1], followup.shape[0]
            write_homography(files["{homography}"], Homography(matrix=homography, size=size))
            words = [
                _PLACEHOLDER.sub(lambda found: str(files[found[0]]), word) for word in self._words
            ]
            said = self._run(words)
            return _read_answer(files["{out}"], said)

    def _run(self, words: list[str]) -> str:
        """Run the command and return the last line that it said."""
        try:
            process = OwnProcess(words, folder=self._folder)
        except OSError as error:
            raise DetectorError(
                f"{short_line(words[0])} cannot be run: {error.strerror}; check its path, and that "
                "it is executable",
                reason="missing",
            ) from error
        try:
            is_done = process.wait(self._timeout_s)
        finally:
            status = process.end()
        said = process.last_line
        if not is_done:
            raise DetectorError(
                f"it was not done within {self._timeout_s:g} s" + which_said(said), reason="hung"
            )
        if status != 0:
            raise DetectorError(how_it_ended(status) + which_said(said), reason="crashed")
        return said


def _read_answer(path: Path, said: str) -> float | Float32Array:
    try:
        data = read_regular_file(path)
    except FileNotFoundError as error:
        raise DetectorError(
            "it wrote nothing to {out}" + which_said(said), reason="output"
        ) from error
    except OSError as error:
        raise DetectorError(
            f"{{out}} cannot be read: {error.strerror}" + which_said(said), reason="output"
        ) from error
    if data.startswith(_TIFF_MAGIC):
        try:
            return plain_answer(np.asarray(read_tiff(data, first_alone=True).images[0]))
        except TiffDamageError as error:
            raise DetectorError(
                f"the TIFF in {{out}} is damaged: {error}", reason="output"
            ) from error
    try:
        number = parse_json(data)
    except ValueError as error:
        raise DetectorError(
            "{out} holds neither a TIFF nor a JSON number" + which_said(said), reason="output"
        ) from error
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise DetectorError(
            f"the JSON in {{out}} is a {type(number).__name__}; expected a number", reason="output"
        )
    return plain_answer(number)
