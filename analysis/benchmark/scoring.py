"""Scores programs on a data set, track by track."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from acquisition.files import Provenance
from analysis.benchmark.alignment_track import score_alignment
from analysis.benchmark.changes import score_changes
from analysis.benchmark.data_set import BenchmarkData
from analysis.benchmark.program_files import ProgramFiles
from analysis.benchmark.psf_track import score_psf
from analysis.benchmark.score_list import Announce, ScoreList
from analysis.benchmark.scores import BenchmarkScores, Score, ScoredProgram
from analysis.benchmark.simulation_track import score_simulation
from analysis.benchmark.stored_models import TRACKS, Track
from analysis.errors import ResultsFileError

Bar = Callable[[str, int], AbstractContextManager[Announce]]
"""Gives a block a function that shows how many tasks are done."""


def scored(
    data: BenchmarkData, programs: Sequence[ProgramFiles], provenance: Provenance, bar: Bar
) -> BenchmarkScores:
    """Score programs in every track that they took part in.

    Raises
    ------
    ResultsFileError
        If a file of the data set or of a program cannot be used, or there is nothing to score.
    """
    names = [one.about.name for one in programs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ResultsFileError(
            f"two folders of results are both of {twice!r}; give them names in about.json"
        )
    scores: list[Score] = []
    shown: list[ScoredProgram] = []
    for files in programs:
        taken = [track for track in TRACKS if data.has(track) and files.has(track)]
        if not taken:
            raise ResultsFileError(
                f"{files.folder} holds no results; expected psf.csv, alignment.json, "
                "detections.json, or folders simulation and changes",
                source=str(files.folder),
            )
        found = [_scores_of(track, data, files, bar) for track in taken]
        scores += [score for one in found for score in one.scores]
        shown.append(
            ScoredProgram(
                **files.about.model_dump(),
                folder=str(files.folder),
                remarks=[remark for one in found for remark in one.remarks],
            )
        )
    manifest = data.manifest
    return BenchmarkScores(
        data_size=manifest.size,
        data_seed=manifest.seed,
        data_sha256=manifest.sha256,
        programs=shown,
        scores=scores,
        provenance=provenance,
    )


def _scores_of(track: Track, data: BenchmarkData, files: ProgramFiles, bar: Bar) -> ScoreList:
    name = files.about.name
    if track == "psf":
        return score_psf(data, files, name)
    if track == "alignment":
        return score_alignment(data, files, name)
    score = score_simulation if track == "simulation" else score_changes
    with bar(f"scoring {track} of {name}", data.tasks_of(track)) as advance_to:
        return score(data, files, name, advance_to)
