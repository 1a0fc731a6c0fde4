"""Readers of images with poses that were not taken by servoscope: one format a file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
