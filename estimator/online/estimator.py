"""The estimator of one tendon as an object: for notebooks, and for data already recorded."""

import dataclasses
import math

from estimator import noise_treatment
from estimator.law.sheath import Sheath
from estimator.measured_data import MeasuredData
from estimator.online import online
from estimator.online.online import Estimates
from estimator.online.tendon_estimate import TendonEstimate
from estimator.online.tendon_model import TendonModel


class Estimator:
    """Estimates the tension at the tip from what is measured at the housing.

    The numbers are those of a live session: the same compiled step runs in both.

    Parameters
    ----------
    model : Sheath or TendonModel
        With a sheath alone, `run` takes the sensor noise from the data, and `step` takes it as
        none.
    """

    def __init__(self, model: Sheath | TendonModel) -> None:
        self._known_noise = isinstance(model, TendonModel)
        self.model = model if isinstance(model, TendonModel) else TendonModel(model)
        self._prepared = online.prepare(self.model)
        self._state = online.build_initial_state(self._prepared)

    def run(self, data: MeasuredData) -> Estimates:
        """Return the estimates of a whole record, from a tendon at its initial tension.

        Parameters
        ----------
        data : MeasuredData
            Time, tension at the housing and, if measured, travel at the housing.

        Returns
        -------
        Estimates
            `tension`, `low` and `high` at the tip [N], `elongation` [m] and more, shape (n,).

        Raises
        ------
        ModelError
            If the arrays are not of one length.
        """
        prepared = self._prepared
        if not self._known_noise:
            travel = data.proximal_displacement
            noise = 0.0 if travel is None else noise_treatment.estimate_noise_sigma(travel)
            sigma = noise_treatment.estimate_noise_sigma(data.proximal_tension)
            noisy = dataclasses.replace(self.model, tension_noise=sigma, displacement_noise=noise)
            prepared = online.prepare(noisy)
        return online.run(prepared, data.time, data.proximal_tension, data.proximal_displacement)

    def step(
        self, tension: float, displacement: float = math.nan, dt: float = 0.0
    ) -> TendonEstimate:
        """Take the next sample, and return the estimate.

        Parameters
        ----------
        tension : float
            T_in [N].
        displacement : float
            q_p [m], positive = pulled in; NaN where there is none.
        dt : float
            Time since the previous sample [s]; 0 for the first.
        """
        estimate, self._state = online.step(self._prepared, self._state, tension, displacement, dt)
        return estimate

    def reset(self) -> None:
        """Start again from the initial tension of the model."""
        self._state = online.build_initial_state(self._prepared)
