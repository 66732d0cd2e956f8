from .app import application as application, run_application as run_application
from .compile_notice import when_compiling as when_compiling
from .compiled_cache import drop_stale_code as drop_stale_code
from .curve_options import (
    CurveContrast as CurveContrast,
    CurveModel as CurveModel,
    CurveNoise as CurveNoise,
    CurveObserver as CurveObserver,
    CurvesPath as CurvesPath,
    MinDprime as MinDprime,
    chosen_curve as chosen_curve,
)
from .edge_table import edge_csv as edge_csv
from .image_options import (
    EncodingName as EncodingName,
    Mean as Mean,
    Page as Page,
    ShortEncoding as ShortEncoding,
    photograph_inputs as photograph_inputs,
)
from .invocation import (
    command_line as command_line,
    note_at_end as note_at_end,
    remarks_so_far as remarks_so_far,
)
from .live_line import LiveLine as LiveLine
from .number_lists import ListedNumbers as ListedNumbers, number_list as number_list
from .operator_prompts import (
    Operator as Operator,
    ScriptedOperator as ScriptedOperator,
    TerminalOperator as TerminalOperator,
    what_to_place as what_to_place,
)
from .option_rules import (
    Option as Option,
    check_options as check_options,
    exactly_one as exactly_one,
    excludes as excludes,
    needs as needs,
)
from .options import (
    BenchFile as BenchFile,
    BenchKeys as BenchKeys,
    Json as Json,
    Threads as Threads,
    TransferForm as TransferForm,
    checked_pitch as checked_pitch,
    checked_zoom as checked_zoom,
    chosen_models as chosen_models,
    place_target as place_target,
    quantity as quantity,
    read_bench as read_bench,
    refuse_overwriting as refuse_overwriting,
    refuse_suffix as refuse_suffix,
    region_corner_and_size as region_corner_and_size,
)
from .output import (
    ERRORS as ERRORS,
    Bar as Bar,
    note as note,
    note_in_passing as note_in_passing,
    print_json as print_json,
    print_table as print_table,
    progress_bar as progress_bar,
    say as say,
    say_error as say_error,
)
from .plan_preview import (
    flicker_warnings as flicker_warnings,
    frame_shape_of as frame_shape_of,
    preview_lines as preview_lines,
    time_text as time_text,
)
from .psf_tables import print_psf as print_psf, print_psf_remarks as print_psf_remarks
from .sharpness_tables import print_edges as print_edges, print_verdict as print_verdict
from .validation_tables import print_validation as print_validation

__all__ = [
    "ERRORS",
    "Bar",
    "BenchFile",
    "BenchKeys",
    "CurveContrast",
    "CurveModel",
    "CurveNoise",
    "CurveObserver",
    "CurvesPath",
    "EncodingName",
    "Json",
    "ListedNumbers",
    "LiveLine",
    "Mean",
    "MinDprime",
    "Operator",
    "Option",
    "Page",
    "ScriptedOperator",
    "ShortEncoding",
    "TerminalOperator",
    "Threads",
    "TransferForm",
    "application",
    "check_options",
    "checked_pitch",
    "checked_zoom",
    "chosen_curve",
    "chosen_models",
    "command_line",
    "drop_stale_code",
    "edge_csv",
    "exactly_one",
    "excludes",
    "flicker_warnings",
    "frame_shape_of",
    "needs",
    "note",
    "note_at_end",
    "note_in_passing",
    "number_list",
    "photograph_inputs",
    "place_target",
    "preview_lines",
    "print_edges",
    "print_json",
    "print_psf",
    "print_psf_remarks",
    "print_table",
    "print_validation",
    "print_verdict",
    "progress_bar",
    "quantity",
    "read_bench",
    "refuse_overwriting",
    "refuse_suffix",
    "region_corner_and_size",
    "remarks_so_far",
    "run_application",
    "say",
    "say_error",
    "time_text",
    "what_to_place",
    "when_compiling",
]
