from .app import application as application, run_application as run_application
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
    checked_zoom as checked_zoom,
    chosen_models as chosen_models,
    pixels as pixels,
    place_target as place_target,
    read_bench as read_bench,
    refuse_overwriting as refuse_overwriting,
    refuse_suffix as refuse_suffix,
    region_corner_and_size as region_corner_and_size,
)
from .output import (
    ERRORS as ERRORS,
    Bar as Bar,
    note as note,
    print_json as print_json,
    print_table as print_table,
    progress_bar as progress_bar,
    say as say,
)
from .plan_preview import (
    flicker_warnings as flicker_warnings,
    frame_shape_of as frame_shape_of,
    preview_lines as preview_lines,
    time_text as time_text,
)
from .psf_tables import print_psf as print_psf, print_psf_remarks as print_psf_remarks
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
    "Json",
    "ListedNumbers",
    "LiveLine",
    "MinDprime",
    "Operator",
    "Option",
    "ScriptedOperator",
    "TerminalOperator",
    "application",
    "check_options",
    "checked_zoom",
    "chosen_curve",
    "chosen_models",
    "drop_stale_code",
    "edge_csv",
    "exactly_one",
    "excludes",
    "flicker_warnings",
    "frame_shape_of",
    "needs",
    "note",
    "number_list",
    "pixels",
    "place_target",
    "preview_lines",
    "print_json",
    "print_psf",
    "print_psf_remarks",
    "print_table",
    "print_validation",
    "progress_bar",
    "read_bench",
    "refuse_overwriting",
    "refuse_suffix",
    "region_corner_and_size",
    "run_application",
    "say",
    "time_text",
    "what_to_place",
]
