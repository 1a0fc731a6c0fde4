from .images import PoseImageSet as PoseImageSet
from .independence import IndependentGroups as IndependentGroups
from .independence import independent_groups as independent_groups
from .splits import Split as Split
from .splits import split_images as split_images
