from ._auc import (
    AucEstimate as AucEstimate,
    ShareInterval as ShareInterval,
    TprEstimate as TprEstimate,
    auc_interval as auc_interval,
    share_interval as share_interval,
    tpr_at_fpr as tpr_at_fpr,
)
from ._curves import (
    MOST_MARKS as MOST_MARKS,
    Disc as Disc,
    FrocCurve as FrocCurve,
    MarkedPair as MarkedPair,
    Marks as Marks,
    PrecisionRecall as PrecisionRecall,
    RocCurve as RocCurve,
    froc as froc,
    marks_of as marks_of,
    precision_recall as precision_recall,
    roc_curve as roc_curve,
)
