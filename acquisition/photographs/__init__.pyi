from ._decoding import LARGEST_IMAGE_PX as LARGEST_IMAGE_PX, read_file as read_file
from ._encoding import (
    LINEAR as LINEAR,
    REC601_LUMA as REC601_LUMA,
    Encoding as Encoding,
    linear_to_srgb as linear_to_srgb,
    luma_plane as luma_plane,
    on_screen as on_screen,
    white_level_dn as white_level_dn,
)
from ._mosaic import UNNAMED_MOSAIC as UNNAMED_MOSAIC
from ._photograph import (
    BenchCapture as BenchCapture,
    FileSteps as FileSteps,
    Photograph as Photograph,
)
from ._raster import (
    marked_png as marked_png,
    tiff_bytes as tiff_bytes,
    write_float_tiff as write_float_tiff,
    write_mask as write_mask,
)
from ._reader import (
    IMAGE_SUFFIXES as IMAGE_SUFFIXES,
    Inputs as Inputs,
    ReadOptions as ReadOptions,
    each_image as each_image,
    frames_of as frames_of,
    image_files_in as image_files_in,
    is_folder as is_folder,
    photograph_of as photograph_of,
    read_photograph as read_photograph,
    taken_as as taken_as,
)
from ._stored_image import (
    CodedSteps as CodedSteps,
    PhotographFacts as PhotographFacts,
    shared_facts as shared_facts,
)
