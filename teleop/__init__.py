"""A teleoperation session from Python, and what both sides share.

    from teleop import Session

The public names are those of `__init__.pyi`.
"""

from estimator.lazy_names import attach_names

__getattr__, __dir__ = attach_names(__name__)
