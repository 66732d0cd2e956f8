from .app import application as application, run_application as run_application
from .command_help import (
    EXAMPLES as EXAMPLES,
    Command as Command,
    examples_text as examples_text,
)
from .curve_options import (
    CurveContrast as CurveContrast,
    CurveModel as CurveModel,
    CurveNoise as CurveNoise,
    CurveObserver as CurveObserver,
    CurvesPath as CurvesPath,
    MinDprime as MinDprime,
    curve_choice as curve_choice,
)
from .hint_options import (
    HINT_RULES as HINT_RULES,
    ExpectZoom as ExpectZoom,
    Mask as Mask,
    Points as Points,
    PoseHint as PoseHint,
)
from .image_options import (
    EncodingName as EncodingName,
    Mean as Mean,
    Page as Page,
    ShortEncoding as ShortEncoding,
    reading_options as reading_options,
)
from .invocation import (
    command_line as command_line,
    is_same_command as is_same_command,
    note_at_end as note_at_end,
    remarks_so_far as remarks_so_far,
)
from .live_line import LiveLine as LiveLine
from .live_texts import focus_display as focus_display, verdict_display as verdict_display
from .number_lists import ListedNumbers as ListedNumbers, number_list as number_list
from .operator_prompts import (
    LONGEST_ANSWER as LONGEST_ANSWER,
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
    Force as Force,
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
    PROGRESS_VARIABLE as PROGRESS_VARIABLE,
    Bar as Bar,
    ShownProgress as ShownProgress,
    note as note,
    note_in_passing as note_in_passing,
    note_once as note_once,
    print_json as print_json,
    print_json_file as print_json_file,
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
from .psf_tables import print_psf as print_psf
from .series_tables import (
    print_few as print_few,
    refuse_sweep_of_one as refuse_sweep_of_one,
    report_refused as report_refused,
    say_part as say_part,
)
from .sharpness_tables import print_edges as print_edges, print_verdict as print_verdict
from .sweep_options import (
    PartOfShards as PartOfShards,
    Scheduler as Scheduler,
    Strict as Strict,
    Workers as Workers,
    sweep_options as sweep_options,
)
from .validation_tables import print_validation as print_validation
