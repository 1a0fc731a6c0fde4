from .interfaces import Camera as Camera
from .interfaces import Estimate as Estimate
from .interfaces import Estimator as Estimator
from .interfaces import Robot as Robot
from .look_and_move import Positioner as Positioner
from .result import PositioningResult as PositioningResult
from .settings import LoopSettings as LoopSettings
