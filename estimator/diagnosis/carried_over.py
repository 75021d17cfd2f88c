"""What of an extended model holds for records of another day, as it does in the loop."""

from dataclasses import replace

import numpy as np

from estimator.diagnosis.dataset import Dataset, Model
from estimator.diagnosis.free_friction import FRICTION_TIME_EFFECTS
from estimator.effects.effect import Effect, EffectContext, Values
from estimator.lumped.lumped_model import Physics
from estimator.online.extension import is_record_specific


def transfer_to_validation(dataset: Dataset, model: Model) -> Model:
    """Return a model of a dataset for other records.

    What happened in a record is left out, and friction that changed in it stays as it was at the
    end of the longest.
    """
    end = max(float(record.time[-1]) for record in dataset.records)
    return model._replace(
        effects=tuple(
            (
                _freeze_friction(end, effect) if effect.name in FRICTION_TIME_EFFECTS else effect,
                values,
            )
            for effect, values in model.effects
            if not is_record_specific(effect)
        )
    )


def _freeze_friction(end: float, effect: Effect) -> Effect:
    """Return an effect on friction that stays as it is at a time [s]."""

    def physics(before: Physics, values: Values, context: EffectContext) -> Physics:
        unit = before._replace(friction=np.ones(2))
        late = effect.physics(unit, values, context._replace(time=np.array([0.0, end])))
        return before._replace(friction=before.friction * late.friction[-1])

    return replace(effect, physics=physics)
