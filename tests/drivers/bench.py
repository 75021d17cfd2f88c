"""Rigs on models of their hardware, and what is asked of every driver."""

import contextlib
import time

import numpy as np

from slave.drivers.cia402.config import BusConfig, Cia402Config
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.microcontroller.config import MicrocontrollerConfig
from slave.rigs.hardware import (
    CellConfig,
    HardwareJointConfig,
    HardwareRig,
    HardwareRigConfig,
    HardwareTendonConfig,
    MotorConfig,
)
from studies.rigs.models.plant import COUNTS, NEWTONS, RADIUS, ZERO

LIMIT_S = 10.0  # [s] of any wait
PATIENT = {"timeout": 0.5}  # a busy machine holds up the models, too


def tendon(motor: int, cell: int, scale: float = NEWTONS, uncertainty=None) -> HardwareTendonConfig:
    return HardwareTendonConfig(
        MotorConfig(id=motor, pulley_radius=RADIUS, counts_per_turn=COUNTS, zero=ZERO),
        CellConfig(id=cell, scale=scale, uncertainty=uncertainty),
    )


def rig_config(motors, cells=None, count: int = 1, scale=NEWTONS, uncertainty=None):
    joints = tuple(
        HardwareJointConfig((tendon(k, k, scale, uncertainty),)) for k in range(1, count + 1)
    )
    return HardwareRigConfig(name="bench", motors=motors, cells=cells, joints=joints)


def microcontroller(port: str, **settings) -> MicrocontrollerConfig:
    return MicrocontrollerConfig(port=port, **PATIENT | settings)


def cia402(port: str, **settings) -> Cia402Config:
    bus = BusConfig(interface="slcan", channel=port, tty_wait=0.0)
    return Cia402Config(bus=bus, **{"rate_hz": 50.0} | PATIENT | settings)


def dynamixel(port: str, **settings) -> DynamixelConfig:
    return DynamixelConfig(port=port, baud=1_000_000, **PATIENT | settings)


@contextlib.contextmanager
def running(model):
    """Let a model of hardware run in a thread of its own."""
    thread = model.start()
    try:
        yield model
    finally:
        model.ended = True
        thread.join()


@contextlib.contextmanager
def opened(config: HardwareRigConfig):
    rig = HardwareRig(config)
    try:
        yield rig
    finally:
        rig.close()


def read_for(rig, duration_s: float, target=None, until=lambda: False):
    """Read, and write if there is a target, as the slave's loop does; return the samples."""
    samples = []
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s and not until():
        samples += rig.read(0.0)
        if target is not None:
            rig.write(np.asarray(target, float))
        time.sleep(0.001)
    return samples


def read_some(rig, count: int = 10):
    samples = []
    end_s = time.monotonic() + LIMIT_S
    while len(samples) < count:
        assert time.monotonic() < end_s, f"{len(samples)} samples"
        samples += read_for(rig, 0.01)
    return samples


def engage(rig, moving, target=None):
    """Write until `moving()`, where the motors are if no target is given; return the target [m]."""
    target = read_some(rig, 2)[-1].proximal_displacement if target is None else target
    read_for(rig, LIMIT_S, target, until=moving)
    assert moving()
    read_for(rig, LIMIT_S, target, until=lambda: rig.follows)  # the driver knows it, too
    assert rig.follows
    return target


def follow(rig, target):
    """Write a target [m] until the motors are there; return the sample that says so."""
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        for sample in read_for(rig, 0.01, target):
            if np.all(np.abs(sample.proximal_displacement - target) < 1e-4):
                return sample
    raise AssertionError("the motors do not arrive")


def wait_until(condition, limit_s: float = 10.0) -> bool:
    until_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > until_s:
            return False
        time.sleep(0.001)
    return True
