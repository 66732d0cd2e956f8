from .app import application as application, run_application as run_application
from .command import Command as Command
from .command_help import EXAMPLES as EXAMPLES, examples_text as examples_text
from .invocation import is_same_command as is_same_command
from .live_line import (
    LiveLine as LiveLine,
    focus_display as focus_display,
    verdict_display as verdict_display,
)
from .next_steps import command_line as command_line, print_next_steps as print_next_steps
from .number_lists import ListedNumbers as ListedNumbers, number_list as number_list
from .operator_prompts import (
    LONGEST_ANSWER as LONGEST_ANSWER,
    Operator as Operator,
    ScriptedOperator as ScriptedOperator,
    TerminalOperator as TerminalOperator,
    what_to_place as what_to_place,
)
from .option_rules import (
    REPORTS as REPORTS,
    Given as Given,
    check_options as check_options,
    exactly_one as exactly_one,
    excludes as excludes,
    needs as needs,
    refuse_overwriting as refuse_overwriting,
    refuse_suffix as refuse_suffix,
)
from .options import (
    HINT_RULES as HINT_RULES,
    AsParquet as AsParquet,
    BenchFile as BenchFile,
    BenchKeys as BenchKeys,
    CurveContrast as CurveContrast,
    CurveModel as CurveModel,
    CurveNoise as CurveNoise,
    CurveObserver as CurveObserver,
    CurvesPath as CurvesPath,
    EncodingName as EncodingName,
    ExpectZoom as ExpectZoom,
    FocalLengthOfTilts as FocalLengthOfTilts,
    FocusScatter as FocusScatter,
    FocusScatterOfPairs as FocusScatterOfPairs,
    Force as Force,
    Json as Json,
    KernelWorkers as KernelWorkers,
    LightScatter as LightScatter,
    Mask as Mask,
    Mean as Mean,
    MinDprime as MinDprime,
    Mirrored as Mirrored,
    OperatorName as OperatorName,
    Page as Page,
    PartOfShards as PartOfShards,
    Points as Points,
    PoseHint as PoseHint,
    ReferenceZoom as ReferenceZoom,
    Scheduler as Scheduler,
    SessionFolder as SessionFolder,
    ShortEncoding as ShortEncoding,
    Strict as Strict,
    Threads as Threads,
    TransferForm as TransferForm,
    Workers as Workers,
    charuco_board as charuco_board,
    checked_pitch as checked_pitch,
    checked_zoom as checked_zoom,
    chosen_models as chosen_models,
    curve_choice as curve_choice,
    parsed_region as parsed_region,
    parsed_size as parsed_size,
    quantity as quantity,
    read_bench as read_bench,
    reading_options as reading_options,
    sweep_options as sweep_options,
)
from .output import (
    ERRORS as ERRORS,
    PROGRESS_VARIABLE as PROGRESS_VARIABLE,
    UPPER_BOUND as UPPER_BOUND,
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
from .plan_preview import preview_line as preview_line, time_text as time_text
from .result_tables import (
    print_edges as print_edges,
    print_psf as print_psf,
    print_validation as print_validation,
    print_verdict as print_verdict,
    value_cells as value_cells,
)
from .series_tables import (
    end_refused as end_refused,
    print_few as print_few,
    refuse_sweep_of_one as refuse_sweep_of_one,
    report_refused as report_refused,
    say_part as say_part,
    say_part_of_curves as say_part_of_curves,
)
