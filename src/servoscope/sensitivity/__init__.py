"""How the error grows once the camera, the light or the robot is not as it was in training."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
