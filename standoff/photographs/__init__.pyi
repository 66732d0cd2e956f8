from .encoding import LINEAR as LINEAR, SRGB as SRGB, Encoding as Encoding
from .exif import PhotographFacts as PhotographFacts
from .photograph import Photograph as Photograph
from .reader import ReadOptions as ReadOptions, read_image as read_image

__all__ = [
    "LINEAR",
    "SRGB",
    "Encoding",
    "Photograph",
    "PhotographFacts",
    "ReadOptions",
    "read_image",
]
