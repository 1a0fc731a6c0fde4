from .acquisition import AcquisitionConfig as AcquisitionConfig
from .acquisition import acquire as acquire
from .dataset import PoseImageSet as PoseImageSet
from .errors import ServoscopeError as ServoscopeError
from .features import Eigenfeatures as Eigenfeatures
from .features import GeometricMoments as GeometricMoments
from .features import ImageBasis as ImageBasis
from .features import LocalFeatureAnalysis as LocalFeatureAnalysis
from .features import PoseImageCovariance as PoseImageCovariance
from .features import compute_image_basis as compute_image_basis
from .formats import ImportOptions as ImportOptions
from .formats import TumOptions as TumOptions
from .formats import read_folder as read_folder
from .formats import read_tum as read_tum
from .poses import DOFS as DOFS
from .positioning import LoopSettings as LoopSettings
from .positioning import Positioner as Positioner
from .positioning import PositioningModel as PositioningModel
from .positioning import PositioningResult as PositioningResult
from .regression import LMRegressor as LMRegressor
from .regression import NetworkJob as NetworkJob
from .regression import PoseRegressor as PoseRegressor
from .regression import train_networks as train_networks
from .selection import MutualInfoSelector as MutualInfoSelector
from .selection import mutual_information as mutual_information
from .selection import pairwise_mutual_information as pairwise_mutual_information

__version__: str
