from .gaussian_process import GaussianProcess as GaussianProcess
from .kernel_ridge import GaussianKernelRidge as GaussianKernelRidge
from .levenberg_marquardt import LMResult as LMResult
from .levenberg_marquardt import LMSettings as LMSettings
from .network import LMRegressor as LMRegressor
from .parallel import NetworkJob as NetworkJob
from .parallel import train_networks as train_networks
from .per_dof import PoseRegressor as PoseRegressor
