from .calibration import calibrate_psf as calibrate_psf
from .comparison import (
    PsfComparison as PsfComparison,
    PsfHistory as PsfHistory,
    compare_psfs as compare_psfs,
    psf_history as psf_history,
)
from .edge_sources import (
    EdgeSources as EdgeSources,
    Reading as Reading,
    edge_image as edge_image,
    from_session as from_session,
)
from .edges import (
    GaussianPsf as GaussianPsf,
    Session as Session,
    TabulatedPsf as TabulatedPsf,
    measure_edges as measure_edges,
    read_psf as read_psf,
    write_edge_table as write_edge_table,
    write_psf as write_psf,
)
from .psf_files import (
    calibration_of as calibration_of,
    camera_psf as camera_psf,
    channel_psfs as channel_psfs,
    frame_psf as frame_psf,
    opened_psf as opened_psf,
    psf_and_field as psf_and_field,
)
