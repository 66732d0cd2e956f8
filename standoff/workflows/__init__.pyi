from .demo import DemoResult as DemoResult, run_demo as run_demo
from .devices import (
    OpenBench as OpenBench,
    open_bench as open_bench,
    open_camera as open_camera,
    open_stage as open_stage,
    place_in_simulation as place_in_simulation,
    refuse_half_simulated as refuse_half_simulated,
)
from .edge_sources import (
    Reading as Reading,
    edge_image as edge_image,
    from_files as from_files,
    from_session as from_session,
)
from .focus_runs import (
    FocusSweep as FocusSweep,
    OpenCamera as OpenCamera,
    opened_camera as opened_camera,
    run_sweep as run_sweep,
    watch_focus as watch_focus,
)
from .followup import (
    CaptureOptions as CaptureOptions,
    FollowUp as FollowUp,
    captured as captured,
    from_pose as from_pose,
    zoomed_out as zoomed_out,
    zoomed_out_as_measured as zoomed_out_as_measured,
)
from .image_files import (
    ImageFile as ImageFile,
    expanded_images as expanded_images,
    read_grey as read_grey,
    read_image as read_image,
    write_float_tiff as write_float_tiff,
    write_mask as write_mask,
)
from .learned_followup import (
    FoundKernel as FoundKernel,
    found_kernel as found_kernel,
    zoomed_out_by_kernel as zoomed_out_by_kernel,
)
from .paper import (
    place_errors_px as place_errors_px,
    run_paper as run_paper,
    short_bench as short_bench,
)
from .pose_stream import (
    NamedFrame as NamedFrame,
    StreamSummary as StreamSummary,
    camera_frames as camera_frames,
    folder_frames as folder_frames,
    judge_stream as judge_stream,
    verdict_display as verdict_display,
    verdict_facts as verdict_facts,
)
from .practice import (
    PracticeCommandError as PracticeCommandError,
    PracticeConsole as PracticeConsole,
)
from .reports import (
    RESULTS_FOLDER as RESULTS_FOLDER,
    make_folder as make_folder,
    require_writable as require_writable,
    write_calibration_report as write_calibration_report,
    write_file as write_file,
    write_geometry_report as write_geometry_report,
    write_page as write_page,
)
from .scene_calibration import calibrate_scenes as calibrate_scenes
from .session_report import write_session_report as write_session_report
from .sr_dataset import (
    SrDatasetSettings as SrDatasetSettings,
    SrDatasetSummary as SrDatasetSummary,
    write_sr_dataset as write_sr_dataset,
)
from .validation_run import (
    default_models as default_models,
    run_validation as run_validation,
)

__all__ = [
    "RESULTS_FOLDER",
    "CaptureOptions",
    "DemoResult",
    "FocusSweep",
    "FollowUp",
    "FoundKernel",
    "ImageFile",
    "NamedFrame",
    "OpenBench",
    "OpenCamera",
    "PracticeCommandError",
    "PracticeConsole",
    "Reading",
    "SrDatasetSettings",
    "SrDatasetSummary",
    "StreamSummary",
    "calibrate_scenes",
    "camera_frames",
    "captured",
    "default_models",
    "edge_image",
    "expanded_images",
    "folder_frames",
    "found_kernel",
    "from_files",
    "from_pose",
    "from_session",
    "judge_stream",
    "make_folder",
    "open_bench",
    "open_camera",
    "open_stage",
    "opened_camera",
    "place_errors_px",
    "place_in_simulation",
    "read_grey",
    "read_image",
    "refuse_half_simulated",
    "require_writable",
    "run_demo",
    "run_paper",
    "run_sweep",
    "run_validation",
    "short_bench",
    "verdict_display",
    "verdict_facts",
    "watch_focus",
    "write_calibration_report",
    "write_file",
    "write_float_tiff",
    "write_geometry_report",
    "write_mask",
    "write_page",
    "write_session_report",
    "write_sr_dataset",
    "zoomed_out",
    "zoomed_out_as_measured",
    "zoomed_out_by_kernel",
]
