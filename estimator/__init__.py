"""Tendon-sheath transmission: its law, the estimator of tip force, calibration and diagnosis.

    import estimator as est

Names are imported when they are first used, so that a control loop loads only what it needs.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimator.calibration.calibration import Calibration as Calibration
    from estimator.calibration.calibration import calibrate as calibrate
    from estimator.calibration.sheath_fit import FitError as FitError
    from estimator.calibration.sheath_fit import SheathFit as SheathFit
    from estimator.calibration.sheath_fit import fit_sheath as fit_sheath
    from estimator.diagnosis.api import CauseError as CauseError
    from estimator.diagnosis.api import RecordError as RecordError
    from estimator.diagnosis.api import diagnose as diagnose
    from estimator.diagnosis.outcome import Diagnosis as Diagnosis
    from estimator.effects import CATALOGUE as CATALOGUE
    from estimator.law.sheath import Section as Section
    from estimator.law.sheath import Sheath as Sheath
    from estimator.law.transmission import Simulation as Simulation
    from estimator.law.transmission import simulate as simulate
    from estimator.measured_data import MeasuredData as MeasuredData
    from estimator.measured_data import Samples as Samples
    from estimator.online.estimator import Estimator as Estimator
    from estimator.online.online import Estimates as Estimates
    from estimator.online.tendon_model import TendonModel as TendonModel
    from estimator.pair.pair import PairRecord as PairRecord
    from estimator.pair.pair_fit import PairError as PairError
    from estimator.pair.pair_study import PairStudy as PairStudy
    from estimator.pair.pair_study import study_pair as study_pair
    from estimator.units import FORCE as FORCE
    from estimator.units import LINEAR as LINEAR
    from estimator.units import ROTARY as ROTARY
    from estimator.units import Units as Units

_EXPORT_MODULES = {
    "Calibration": "calibration.calibration",
    "calibrate": "calibration.calibration",
    "FitError": "calibration.sheath_fit",
    "SheathFit": "calibration.sheath_fit",
    "fit_sheath": "calibration.sheath_fit",
    "CauseError": "diagnosis.api",
    "RecordError": "diagnosis.api",
    "diagnose": "diagnosis.api",
    "Diagnosis": "diagnosis.outcome",
    "CATALOGUE": "effects",
    "Section": "law.sheath",
    "Sheath": "law.sheath",
    "Simulation": "law.transmission",
    "simulate": "law.transmission",
    "MeasuredData": "measured_data",
    "Samples": "measured_data",
    "Estimator": "online.estimator",
    "Estimates": "online.online",
    "TendonModel": "online.tendon_model",
    "FORCE": "units",
    "LINEAR": "units",
    "ROTARY": "units",
    "Units": "units",
    "PairRecord": "pair.pair",
    "PairError": "pair.pair_fit",
    "PairStudy": "pair.pair_study",
    "study_pair": "pair.pair_study",
}

__all__ = [
    "CATALOGUE",
    "FORCE",
    "LINEAR",
    "ROTARY",
    "Calibration",
    "CauseError",
    "Diagnosis",
    "Estimates",
    "Estimator",
    "FitError",
    "MeasuredData",
    "PairError",
    "PairRecord",
    "PairStudy",
    "RecordError",
    "Samples",
    "Section",
    "Sheath",
    "SheathFit",
    "Simulation",
    "TendonModel",
    "Units",
    "calibrate",
    "diagnose",
    "fit_sheath",
    "simulate",
    "study_pair",
]


def __getattr__(name: str) -> Any:
    """Import a public name from its module (PEP 562)."""
    if name not in _EXPORT_MODULES:
        raise AttributeError(f"module 'estimator' has no attribute {name!r}")
    return getattr(importlib.import_module(f"estimator.{_EXPORT_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
