"""A session as one OME-TIFF file (BigTIFF): a page for each mean and variance, float32."""

from pathlib import Path

import tifffile

from acquisition.session_export.ome_model import OmeDocument
from acquisition.session_export.source import ExportSource


def write_ome_tiff(path: Path, source: ExportSource) -> None:
    """Write every capture; the OME-XML, which names the pages, comes last.

    Raises
    ------
    SessionError
        If a capture cannot be read.
    OSError
        If the file cannot be written.
    """
    document = OmeDocument(source, has_pixels_here=True)
    with tifffile.TiffWriter(path, bigtiff=True, byteorder="<", ome=False) as file:
        description = "to be replaced"
        for images in source.captures():
            planes = [images.mean_dn]
            if images.variance_dn2 is not None:
                planes.append(images.variance_dn2)
            for plane in planes:
                file.write(
                    plane,
                    photometric="minisblack",
                    metadata=None,
                    description=description,
                    software="standoff",
                )
                description = ""
            document.add(images.record, images.mean_dn.shape, len(planes))
    tifffile.tiffcomment(path, document.to_bytes())
