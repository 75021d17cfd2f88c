"""The bench of the paper's figure 5, simulated: one joint, two tendons, a load motor on the joint.

Both tendons run in sheaths of the same shape, as in one overtube. During initialisation the joint
is free. In the experiment the load motor, which is torque-controlled, acts as a spring: its torque
is proportional to the joint's travel.
"""

from slave.rigs.simulated.plant.body import BodyConfig
from slave.rigs.simulated.plant.environment import FreeConfig, LoadMotorConfig
from slave.rigs.simulated.plant.sensors import LoadCellConfig
from slave.rigs.simulated.simulated import (
    JointConfig,
    SimulatedRig,
    SimulatedRigConfig,
    TendonPlantConfig,
)
from studies.paper.sheaths import Specimen

PERIOD = 0.001  # [s] of the plant and of every sensor
PRETENSION = 0.5  # [N] of both tendons when the motors start
LOAD_STIFFNESS = 3000.0  # [N/m] of the spring rendered by the load motor
BODY = BodyConfig(
    mass=0.02,
    damping=2.0,
    friction=0.1,
    spring=0.0,
    pretension=PRETENSION,
    stops=(-0.008, 0.008),  # [m]
)


def build(specimen: Specimen, seed: int, loaded: bool) -> SimulatedRig:
    """Return the bench at rest in the middle of its travel; noise of the sensors by `seed`."""
    cell = LoadCellConfig(noise=specimen.tension_noise)
    tendon = TendonPlantConfig(sheath=specimen.sheath, load_cell=cell)
    load = LoadMotorConfig(mode="position", stiffness=LOAD_STIFFNESS) if loaded else FreeConfig()
    joint = JointConfig((tendon, tendon), BODY, load)
    return SimulatedRig(
        SimulatedRigConfig(name="paper's bench", joints=(joint,), period=PERIOD, seed=seed)
    )


def stretch_at_rest(specimen: Specimen) -> float:
    """Return the elongation [m] of a tendon while the bench is at rest."""
    return PRETENSION * specimen.length / specimen.sheath.axial_stiffness
