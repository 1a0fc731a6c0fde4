from .eigenfeatures import Eigenfeatures as Eigenfeatures
from .image_basis import ImageBasis as ImageBasis
from .image_basis import compute_image_basis as compute_image_basis
from .lfa import LocalFeatureAnalysis as LocalFeatureAnalysis
from .moments import GeometricMoments as GeometricMoments
from .pose_covariance import PoseImageCovariance as PoseImageCovariance
