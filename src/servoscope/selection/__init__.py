"""Which features to use: mutual information, ranking, and minimum subsets."""

# Not loaded lazily: the function `mutual_information` must hide the module of that name.
from servoscope.selection.binning import bin_codes
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.mutual_information import (
    mutual_information,
    pairwise_mutual_information,
)
from servoscope.selection.ranking import Ranking
from servoscope.selection.selector import CRITERIA, MutualInfoSelector
from servoscope.selection.stability import OrderStability, order_stability
from servoscope.selection.sweep import ThresholdSubset, best_subset, threshold_subsets

__all__ = [
    "CRITERIA",
    "MutualInfoSelector",
    "OrderStability",
    "Ranking",
    "ThresholdSubset",
    "best_subset",
    "bin_codes",
    "mutual_information",
    "order_stability",
    "pairwise_mutual_information",
    "rank_ideal_point",
    "threshold_subsets",
]
