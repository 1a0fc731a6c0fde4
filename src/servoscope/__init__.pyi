from .dataset import PoseImageSet as PoseImageSet
from .errors import ServoscopeError as ServoscopeError
from .poses import DOFS as DOFS
