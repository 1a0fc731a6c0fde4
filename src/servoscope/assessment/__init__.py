"""Assessment: what each degree of freedom will reach, what limits it, and what would help."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
