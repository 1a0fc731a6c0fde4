"""Images with their poses: in memory and on disk, which are independent, and what is wrong."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
