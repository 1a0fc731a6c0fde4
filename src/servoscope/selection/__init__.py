"""Which features to use: mutual information, ranking, and minimum subsets."""

# Not loaded lazily: the function `mutual_information` must hide the module of that name.
from servoscope.selection.bias import corrected_mutual_information, information_bias
from servoscope.selection.binning import bin_codes
from servoscope.selection.bootstrap import InformationInterval, information_interval
from servoscope.selection.candidates import Candidates
from servoscope.selection.cmim import rank_cmim
from servoscope.selection.conditional import rank_conditional
from servoscope.selection.criteria import CRITERIA
from servoscope.selection.crossfit import (
    FeatureFamily,
    Fold,
    crossfit_forecast,
    forecast_from_folds,
    refit_features,
)
from servoscope.selection.entropy_power import EntropyPower, entropy_power
from servoscope.selection.equal_frequency import equal_frequency_information
from servoscope.selection.estimators import ESTIMATORS, estimate_information, ksg_information
from servoscope.selection.forecast import Forecast, forecast_errors
from servoscope.selection.forward_selection import (
    ForwardRanking,
    forward_selection,
    rank_forward,
)
from servoscope.selection.gaussian_copula import gaussian_copula_information
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.ideal_point_corrected import (
    rank_ideal_point_corrected,
    redundancy_bias,
)
from servoscope.selection.jmi import rank_jmi
from servoscope.selection.learning_curve import LearningCurve, PredictedError, learning_curve
from servoscope.selection.mrmr import rank_mrmr
from servoscope.selection.mutual_information import (
    mutual_information,
    pairwise_mutual_information,
)
from servoscope.selection.ranking import Ranking
from servoscope.selection.selector import MutualInfoSelector
from servoscope.selection.significance import InformationTest, information_test
from servoscope.selection.stability import OrderStability, order_stability
from servoscope.selection.sweep import ThresholdSubset, best_subset, threshold_subsets

__all__ = [
    "CRITERIA",
    "ESTIMATORS",
    "Candidates",
    "EntropyPower",
    "FeatureFamily",
    "Fold",
    "Forecast",
    "ForwardRanking",
    "InformationInterval",
    "InformationTest",
    "LearningCurve",
    "MutualInfoSelector",
    "OrderStability",
    "PredictedError",
    "Ranking",
    "ThresholdSubset",
    "best_subset",
    "bin_codes",
    "corrected_mutual_information",
    "crossfit_forecast",
    "entropy_power",
    "equal_frequency_information",
    "estimate_information",
    "forecast_errors",
    "forecast_from_folds",
    "forward_selection",
    "gaussian_copula_information",
    "information_bias",
    "information_interval",
    "information_test",
    "ksg_information",
    "learning_curve",
    "mutual_information",
    "order_stability",
    "pairwise_mutual_information",
    "rank_cmim",
    "rank_conditional",
    "rank_forward",
    "rank_ideal_point",
    "rank_ideal_point_corrected",
    "rank_jmi",
    "rank_mrmr",
    "redundancy_bias",
    "refit_features",
    "threshold_subsets",
]
