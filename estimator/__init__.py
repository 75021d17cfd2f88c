"""Tendon-sheath transmission: its law, the estimator of tip force, calibration and diagnosis.

    import estimator as est

The public names are those of `__init__.pyi`.
"""

from estimator.lazy_names import attach_names

__getattr__, __dir__ = attach_names(__name__)
