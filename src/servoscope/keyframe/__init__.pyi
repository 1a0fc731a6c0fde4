from .alignment import Alignment as Alignment
from .camera import CameraModel as CameraModel
from .held_out import HeldOutLooks as HeldOutLooks
from .held_out import held_out_looks as held_out_looks
from .keyframe import Keyframe as Keyframe
from .limit import ViewLimit as ViewLimit
