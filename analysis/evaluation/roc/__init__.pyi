from .auc import AucEstimate as AucEstimate, auc_interval as auc_interval
from .curves import (
    PrecisionRecall as PrecisionRecall,
    RocCurve as RocCurve,
    precision_recall as precision_recall,
    roc_curve as roc_curve,
)
from .free_response import FrocCurve as FrocCurve, MarkedPair as MarkedPair, froc as froc
from .marks import MOST_MARKS as MOST_MARKS, Disc as Disc, Marks as Marks, marks_of as marks_of
from .operating_point import TprEstimate as TprEstimate, tpr_at_fpr as tpr_at_fpr
from .share_interval import ShareInterval as ShareInterval, share_interval as share_interval
