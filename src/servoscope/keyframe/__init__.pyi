from .alignment import Alignment as Alignment
from .camera import CameraModel as CameraModel
from .keyframe import Keyframe as Keyframe
from .limit import ViewLimit as ViewLimit
