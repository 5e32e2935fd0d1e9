"""nbv_gym: Gymnasium environments for 3-D next-best-view planning.

``import nbv_gym`` registers the environments and does nothing else.
"""

from importlib.metadata import version

__version__ = version("nbv-gym")
__all__ = ["__version__"]
