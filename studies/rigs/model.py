"""A model of a bus with its plant, in a process of its own.

  python -m studies.rigs.model DRIVER MOTORS PLANT [ordinary]       PLANT: tendons or springs

The first line that it prints is the buses of a config, as JSON. Orders on standard input: fault,
repair, unplug, plug, state; each prints which motors follow, where they are, when the last one was
stopped and when one last moved (monotonic clock). `ordinary`: without real-time priority, for an
emulated processor.
"""

import gc
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import can
import numpy as np

from studies.rigs.bench import BUS
from studies.rigs.models import drives
from studies.rigs.models.board import ENABLED, Board, compile_firmware
from studies.rigs.models.drives import ENABLED as OPERATION
from studies.rigs.models.drives import Drives, SlcanAdapter
from studies.rigs.models.line import PseudoPort
from studies.rigs.models.plant import Springs, Tendons
from studies.rigs.models.servos import ERROR, TORQUE, Servos
from teleop.runtime.realtime import RealtimeConfig, request_realtime

LOOK_S = 0.001  # [s] between two looks at whether motors move
STEP = 1.0  # [counts] that are a motion
EMULATED_ROUND_S, EMULATED_LOOK_S = 0.004, 0.002
FOLDER = Path(tempfile.mkdtemp(prefix="rig-model-"))


def name_port(name: str) -> Path:
    """Return the name of a port, which stays when it is unplugged and plugged in again."""
    return FOLDER / name


class Followed:
    """The cells of a plant that another bus moves."""

    def __init__(self, plant) -> None:
        self._plant, self.position = plant, np.zeros(plant.motors)

    def advance(self, *_) -> None:
        """Do nothing: the other bus does."""

    def read_cells(self):
        return self._plant.read_cells()


class BusModel:
    """What the orders on standard input act on."""

    def repair(self) -> None:
        """Do nothing: a fault is kept until a restart or a reset."""


class Microcontroller(BusModel):
    def __init__(self, motors, plant) -> None:
        self.models = [
            Board(compile_firmware(FOLDER), motors, motors, plant, 1.0, name_port("motors"))
        ]
        self.board = self.models[0]
        self.buses = {"motors": {"type": "microcontroller", "port": self.board.port.name}}

    def fault(self) -> None:
        self.board.fault = True

    def repair(self) -> None:
        self.board.fault = False

    def connect(self, plugged: bool) -> None:
        self.board.port.wanted = plugged

    def list_moving(self) -> list[bool]:
        return [bool(self.board.flags & ENABLED)]


class Dynamixel(BusModel):
    """Servos, and a microcontroller for the load cells alone."""

    def __init__(self, motors, plant) -> None:
        self.servos = Servos(range(1, motors + 1), plant, 1.0, name_port("motors"))
        board = Board(compile_firmware(FOLDER), 0, motors, Followed(plant), 1.0, name_port("cells"))
        self.models = [self.servos, board]
        self.buses = {
            "motors": {"type": "dynamixel", "port": self.servos.port.name},
            "cells": {"type": "microcontroller", "port": board.port.name},
        }

    def fault(self) -> None:
        self.servos.servos[1].put(ERROR, 1, 32)
        self.servos.servos[1].put(TORQUE, 1, 0)  # as the servo does by itself

    def connect(self, plugged: bool) -> None:
        self.servos.port.wanted = plugged

    def list_moving(self) -> list[bool]:
        return [servo.moving for servo in self.servos.servos.values()]


class Cia402(BusModel):
    """Drives with their load cells, behind an slcan adapter, or on another bus of python-can."""

    def __init__(self, motors, plant) -> None:
        rate_hz = 500.0 if motors <= 7 else 400.0
        self.port = None
        if BUS in os.environ:
            interface, channel = os.environ[BUS].split(",")
            described = {"interface": interface, "channel": channel}
            bus = can.Bus(**described)
        else:
            self.port = PseudoPort(name_port("motors"))
            bus = SlcanAdapter(self.port)
            described = {"interface": "slcan", "channel": self.port.name, "tty_wait": 0.0}
        self.drives = Drives(bus, range(1, motors + 1), plant, patience=1.0)
        self.models = [self.drives]
        self.buses = {"motors": {"type": "cia402", "bus": described, "rate_hz": rate_hz}}

    def fault(self) -> None:
        self.drives.drives[0].fail(0x8611)

    def connect(self, plugged: bool) -> None:
        if self.port is not None:
            self.port.wanted = plugged
        self.drives.silent = not plugged

    def list_moving(self) -> list[bool]:
        return [drive.state == OPERATION for drive in self.drives.drives]


class Off:
    """Which motors follow their targets, when the last one stopped to, and when one last moved."""

    def __init__(self, model, plant, look_s: float) -> None:
        self.at_s = self.moved_s = 0.0  # on the monotonic clock
        self._model, self._plant, self._look_s = model, plant, look_s
        self._position = np.array(plant.position, float)
        self._moved, self._lock = False, threading.Lock()

    def look(self) -> list[bool]:
        """Return which motors follow; if none does any more, `at_s` is set already."""
        with self._lock:
            position = np.array(self._plant.position, float)
            if np.any(np.abs(position - self._position) >= STEP):
                self._position, self.moved_s = position, time.monotonic()
            moving = self._model.list_moving()
            if self._moved and not any(moving):
                self.at_s = time.monotonic()
            self._moved = any(moving)
            return moving

    def watch(self) -> None:
        while True:
            self.look()
            time.sleep(self._look_s)


MODELS = {"microcontroller": Microcontroller, "dynamixel": Dynamixel, "cia402": Cia402}


def main(driver: str, count: str, kind: str, *ordinary: str) -> None:
    motors = int(count)
    if kind == "springs":
        plant = Springs(motors)
    else:
        plant = Tendons(max(1, motors // 2), paired=motors > 1)
    plant.motors = motors
    model = MODELS[driver](motors, plant)
    if ordinary:
        drives.ROUND_S = EMULATED_ROUND_S
    else:
        request_realtime(RealtimeConfig(priority=30, cores=()))
    threads = [threading.Thread(target=one.serve, daemon=True) for one in model.models]
    gc.collect()
    gc.disable()  # a collection takes longer than a watchdog waits
    for thread in threads:
        thread.start()
    off = Off(model, plant, EMULATED_LOOK_S if ordinary else LOOK_S)
    threading.Thread(target=off.watch, daemon=True).start()
    print(json.dumps(model.buses), flush=True)
    for line in sys.stdin:
        order = line.strip()
        if order in ("fault", "repair"):
            getattr(model, order)()
        elif order in ("unplug", "plug"):
            model.connect(order == "plug")
        state = {
            "moving": off.look(),
            "position": np.asarray(plant.position, float).tolist(),
            "stopped_s": off.at_s,
            "moved_s": off.moved_s,
            "cpu_s": time.process_time(),
        }
        print(json.dumps(state), flush=True)


if __name__ == "__main__":
    sys.setswitchinterval(0.0005)
    try:
        main(*sys.argv[1:])
    finally:
        shutil.rmtree(FOLDER, ignore_errors=True)
