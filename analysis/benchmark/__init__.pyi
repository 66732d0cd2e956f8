from ._data_set import (
    MANIFEST_NAME as MANIFEST_NAME,
    BenchmarkData as BenchmarkData,
    Track as Track,
)
from ._plot import score_figure as score_figure
from ._program_files import ProgramFiles as ProgramFiles
from ._tracks import scored as scored
from .scores import (
    MEASURES as MEASURES,
    TITLES as TITLES,
    BenchmarkScores as BenchmarkScores,
    Measure as Measure,
    Score as Score,
    ScoredProgram as ScoredProgram,
    read_scores as read_scores,
)
from .tables import (
    CHOSEN as CHOSEN,
    LEGEND as LEGEND,
    ScoreTable as ScoreTable,
    main_groups as main_groups,
    markdown as markdown,
    parts_of as parts_of,
    score_tables as score_tables,
    track_tables as track_tables,
)
