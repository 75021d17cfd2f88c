"""A model of a bus with its plant, in a process of its own.

  python -m benchmarks.rigs.model DRIVER MOTORS PLANT       PLANT: tendons or springs

The first line that it prints is the buses of a config, as JSON. Orders on standard input: fault,
unplug, state; each prints which motors follow, where they are, and when the last one was stopped
(monotonic clock).
"""

import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from teleop.realtime import RealtimeConfig, go_realtime
from tests.drivers.models.board import ENABLED, Board, compile_firmware
from tests.drivers.models.drives import ENABLED as OPERATION
from tests.drivers.models.drives import Drives, SlcanAdapter
from tests.drivers.models.line import PseudoPort
from tests.drivers.models.plant import Springs, Tendons
from tests.drivers.models.servos import ERROR, Servos


class Followed:
    """The cells of a plant that another bus moves."""

    def __init__(self, plant) -> None:
        self._plant, self.position = plant, np.zeros(plant.motors)

    def advance(self, *_) -> None:
        """Do nothing: the other bus does."""

    def cells(self):
        return self._plant.cells()


class Microcontroller:
    def __init__(self, motors, plant, library) -> None:
        self.models = [Board(library, motors, motors, plant, patience=1.0)]
        self.board = self.models[0]
        self.buses = {"motors": {"type": "microcontroller", "port": self.board.port.name}}

    def fault(self) -> None:
        self.board.fault = True

    def unplug(self) -> None:
        self.board.ended = True

    def moving(self) -> list[bool]:
        return [bool(self.board.flags & ENABLED)]


class Dynamixel:
    """Servos, and a microcontroller for the load cells alone."""

    def __init__(self, motors, plant, library) -> None:
        self.servos = Servos(range(1, motors + 1), plant, patience=1.0)
        board = Board(library, 0, motors, Followed(plant), patience=1.0)
        self.models = [self.servos, board]
        self.buses = {
            "motors": {"type": "dynamixel", "port": self.servos.port.name},
            "cells": {"type": "microcontroller", "port": board.port.name},
        }

    def fault(self) -> None:
        self.servos.servos[1].put(ERROR, 1, 32)

    def unplug(self) -> None:
        self.servos.ended = True

    def moving(self) -> list[bool]:
        return [servo.moving for servo in self.servos.servos.values()]


class Cia402:
    """Drives with their load cells, behind an slcan adapter or on UDP multicast."""

    def __init__(self, motors, plant, _library) -> None:
        rate_hz = 500.0 if motors <= 7 else 400.0
        channel = os.environ.get("CAN_MULTICAST")
        if channel:
            import can

            bus = can.Bus(interface="udp_multicast", channel=channel, hop_limit=0)
            described = {"interface": "udp_multicast", "channel": channel}
        else:
            port = PseudoPort()
            bus = SlcanAdapter(port)
            described = {"interface": "slcan", "channel": port.name, "tty_wait": 0.0}
        self.drives = Drives(bus, range(1, motors + 1), plant, patience=1.0)
        self.models = [self.drives]
        self.buses = {"motors": {"type": "cia402", "bus": described, "rate_hz": rate_hz}}

    def fault(self) -> None:
        self.drives.drives[0].fail(0x8611)

    def unplug(self) -> None:
        self.drives.unplug = True
        self.drives.silent = True

    def moving(self) -> list[bool]:
        return [drive.state == OPERATION for drive in self.drives.drives]


class Off:
    """When the last motor that moved has been stopped.

    Attributes
    ----------
    at_s : float
        On the monotonic clock.
    """

    def __init__(self, model) -> None:
        self.at_s, self._model = 0.0, model

    def watch(self) -> None:
        moved = False
        while True:
            moves = any(self._model.moving())
            if moved and not moves:
                self.at_s = time.monotonic()
            moved = moves
            time.sleep(0.001)


MODELS = {"microcontroller": Microcontroller, "dynamixel": Dynamixel, "cia402": Cia402}


def main(driver: str, count: str, kind: str) -> None:
    motors = int(count)
    if kind == "springs":
        plant = Springs(motors)
    else:
        plant = Tendons(max(1, motors // 2), paired=motors > 1)
    plant.motors = motors
    library = compile_firmware(Path(tempfile.mkdtemp()))
    go_realtime(RealtimeConfig(priority=30, cores=()))
    model = MODELS[driver](motors, plant, library)
    threads = [threading.Thread(target=one.serve, daemon=True) for one in model.models]
    for thread in threads:
        thread.start()
    off = Off(model)
    threading.Thread(target=off.watch, daemon=True).start()
    print(json.dumps(model.buses), flush=True)
    for line in sys.stdin:
        order = line.strip()
        if order in ("fault", "unplug"):
            getattr(model, order)()
        state = {
            "moving": model.moving(),
            "position": np.asarray(plant.position, float).tolist(),
            "stopped_s": off.at_s,
            "cpu_s": time.process_time(),
        }
        print(json.dumps(state), flush=True)


if __name__ == "__main__":
    sys.setswitchinterval(0.0005)
    main(*sys.argv[1:])
