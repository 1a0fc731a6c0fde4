from .measurement import ErrorGrowth as ErrorGrowth
from .measurement import PoseModel as PoseModel
from .measurement import fit_pose_model as fit_pose_model
from .measurement import measure as measure
from .measurement import predict_rms as predict_rms
from .measurement import take_images as take_images
from .run import SensitivityConfig as SensitivityConfig
from .run import SensitivityRun as SensitivityRun
