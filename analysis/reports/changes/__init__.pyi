from .limit_map import limit_figure as limit_figure
from .pictures import (
    ColourPair as ColourPair,
    ComparedPictures as ComparedPictures,
    compared_pictures as compared_pictures,
)
from .sections import (
    changes_section as changes_section,
    count_text as count_text,
    limit_section as limit_section,
    q_text as q_text,
    render_changes_report as render_changes_report,
)
from .stored import (
    stored_changes_section as stored_changes_section,
    stored_pose_section as stored_pose_section,
)
from .time_line import render_series_report as render_series_report
from .views import view_figures as view_figures
