"""Bringing the camera back to a reference view: estimators, the loop, and its guard."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
