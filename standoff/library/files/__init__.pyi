from .image_files import (
    each_image as each_image,
    image_files_in as image_files_in,
    is_folder as is_folder,
    write_float_tiff as write_float_tiff,
    write_mask as write_mask,
)
from .output_files import (
    RESULTS_FOLDER as RESULTS_FOLDER,
    is_there as is_there,
    make_folder as make_folder,
    make_results_folder as make_results_folder,
    require_writable as require_writable,
    write_file as write_file,
    written_together as written_together,
)
from .reachable import (
    FIGURES as FIGURES,
    FLOAT_IMAGES as FLOAT_IMAGES,
    PAGES as PAGES,
    refusal_text as refusal_text,
    require_folder as require_folder,
    require_place as require_place,
    require_reachable as require_reachable,
)
from .report_files import write_figure as write_figure, write_page as write_page
