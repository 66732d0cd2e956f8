from ._documents import (
    InputFile as InputFile,
    Provenance as Provenance,
    StoredModel as StoredModel,
    utc_now as utc_now,
)
from ._names import (
    FIGURES as FIGURES,
    FLOAT_IMAGES as FLOAT_IMAGES,
    PAGES as PAGES,
    refusal_text as refusal_text,
    require_folder as require_folder,
    require_place as require_place,
    require_reachable as require_reachable,
)
from ._writing import (
    RESULTS_FOLDER as RESULTS_FOLDER,
    is_there as is_there,
    make_folder as make_folder,
    make_results_folder as make_results_folder,
    require_writable as require_writable,
    write_file as write_file,
    write_page as write_page,
    written_together as written_together,
)
