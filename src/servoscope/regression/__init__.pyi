from .kernel_regressors import GaussianKernelRidge as GaussianKernelRidge
from .kernel_regressors import GaussianProcess as GaussianProcess
from .levenberg_marquardt import LMResult as LMResult
from .levenberg_marquardt import LMSettings as LMSettings
from .network_regressors import BayesianLMRegressor as BayesianLMRegressor
from .network_regressors import LBFGSRegressor as LBFGSRegressor
from .network_regressors import LMRegressor as LMRegressor
from .registry import REGRESSORS as REGRESSORS
