"""A Drake laboratory for quadrotor tracking control."""

import lazy_loader

__version__ = "0.2.0"

# `__init__.pyi` lists the public names. They are imported when first used, since importing Drake takes a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
