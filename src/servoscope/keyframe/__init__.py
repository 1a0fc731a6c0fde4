"""The reference view as a calibrated keyframe: camera, mount, and a depth for every pixel."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
