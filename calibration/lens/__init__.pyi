from ._capacity import (
    CapacityFigures as CapacityFigures,
    DetectionFigure as DetectionFigure,
    capacity_figures as capacity_figures,
)
from ._document import (
    Colour as Colour,
    ColourFigures as ColourFigures,
    DataSheetFigure as DataSheetFigure,
    EdgeOfColour as EdgeOfColour,
    LateralShift as LateralShift,
    LensMeasurement as LensMeasurement,
    SharpeningFigures as SharpeningFigures,
    camera_figures as camera_figures,
    colour_figures as colour_figures,
    data_sheet as data_sheet,
    figure_rows as figure_rows,
    frequency_units as frequency_units,
    lateral_shifts as lateral_shifts,
)
from ._lateral_colour import (
    LateralColourField as LateralColourField,
    ShiftVector as ShiftVector,
    lateral_fields as lateral_fields,
)
from ._targets import (
    SectorFigures as SectorFigures,
    StarFigures as StarFigures,
    star_figures as star_figures,
)
from ._texture import (
    TextureFigures as TextureFigures,
    texture_figures as texture_figures,
)
from ._through_focus import (
    FocusField as FocusField,
    FocusPoint as FocusPoint,
    StatedContrast as StatedContrast,
    ThroughFocus as ThroughFocus,
    through_focus as through_focus,
)
