"""Vision-based robot positioning from whole images.

"The paper", here and in every module: G. Wells and C. Torras, "Assessing image features for
vision-based robot positioning", Journal of Intelligent and Robotic Systems 30 (2001), 95-118.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.2.0"
