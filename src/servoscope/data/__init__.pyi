from .images import PoseImageSet as PoseImageSet
from .independence import IndependentGroups as IndependentGroups
from .independence import independent_groups as independent_groups
from .independence import split_data as split_data
from .splits import Split as Split
from .splits import split_images as split_images
