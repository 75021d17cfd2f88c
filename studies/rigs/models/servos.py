"""Dynamixel servos of the X series on a pty, written from the e-manual without the SDK.

Packets: FF FF FD 00, id, length (2), instruction, parameters, CRC-16 (poly 0x8005), with FD after
each FF FF FD of the body. Control table: the registers that the driver may use, as bytes.
"""

import struct
import time

import numpy as np

from studies.rigs.models.line import BusThread, PseudoPort
from studies.rigs.models.plant import ZERO, Springs

PING, READ, WRITE, REBOOT, SYNC_READ, SYNC_WRITE, STATUS = 1, 2, 3, 8, 0x82, 0x83, 0x55
BROADCAST = 254
HEADER = b"\xff\xff\xfd\x00"
EEPROM_END = 64
DATA_RANGE, ACCESS, ALERT = 4, 7, 0x80
TORQUE, ERROR, WATCHDOG, GOAL, CURRENT, POSITION, VOLTAGE, TEMPERATURE = (
    64, 70, 98, 116, 126, 132, 144, 146,
)  # fmt: skip
OPERATING_MODE, CURRENT_LIMIT, GOAL_CURRENT = 11, 38, 102
LIMITING_MODES = (0, 5)  # in which the goal current and its limit act
X330 = range(1190, 1250)  # models with 20 indirect addresses, and their data before 228
WITHOUT_CURRENT = (1060, 1070, 1080, 1090, 1160)  # models: XL430, XC430, 2XL430, 2XC430
DRIVE_MODE, SECONDARY_ID, HOMING_OFFSET, STATUS_RETURN = 10, 12, 20, 68
STARTUP, SHUTDOWN = 60, 63
ACCELERATION, PROFILE_VELOCITY = 108, 112
REVERSE, TIME_BASED, TORQUE_BY_GOAL = 1, 4, 8  # of the drive mode
WATCHDOG_UNIT_S = 0.020
ROUND_S = 0.0005  # [s] between two looks at the plant


def _shift_byte(crc: int) -> int:
    """Return a CRC register after eight bits of zero."""
    for _ in range(8):
        crc = ((crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


TABLE = [_shift_byte(byte << 8) for byte in range(256)]


def compute_crc(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ TABLE[crc >> 8 ^ byte]
    return crc


class Servo:
    def __init__(self, number: int) -> None:
        self.number = number
        self.table = bytearray(256 + 512)
        self.put(0, 2, 1020)  # XM430-W350
        self.put(POSITION, 4, int(ZERO))
        self.put(GOAL, 4, 777_777)  # an old one, far away
        self.put(VOLTAGE, 2, 120)
        self.put(TEMPERATURE, 1, 35)
        self.put(SECONDARY_ID, 1, 255)
        self.put(STATUS_RETURN, 1, 2)
        self.put(SHUTDOWN, 1, 0x34)  # overload, electrical shock, too hot
        self.put(OPERATING_MODE, 1, 3)
        self.put(CURRENT_LIMIT, 2, 1193)
        self.put(GOAL_CURRENT, 2, 1193)
        self.heard_s = 0.0

    def put(self, address: int, size: int, value: int) -> None:
        self.table[address : address + size] = (value % (1 << 8 * size)).to_bytes(size, "little")

    def get(self, address: int, size: int, signed: bool = False) -> int:
        return int.from_bytes(self.table[address : address + size], "little", signed=signed)

    def where(self, address: int) -> int:
        first, end = (208, 228) if self.get(0, 2) in X330 else (224, 252)
        return self.get(168 + 2 * (address - first), 2) if first <= address < end else address

    def read(self, address: int, size: int) -> bytes:
        if self.get(0, 2) in X330 and address + size > 228:
            return b""
        return bytes(self.table[self.where(address + k)] for k in range(size))

    def write(self, address: int, data: bytes) -> int:
        """Write; return the error number."""
        if address < EEPROM_END and self.table[TORQUE]:
            return ACCESS
        if address == GOAL and self.table[WATCHDOG] == 255:
            return DATA_RANGE
        value = int.from_bytes(data, "little")
        limits_current = address == OPERATING_MODE and value in LIMITING_MODES
        if limits_current and self.get(0, 2) in WITHOUT_CURRENT:
            return DATA_RANGE
        if address == GOAL_CURRENT and value > self.get(CURRENT_LIMIT, 2):
            return DATA_RANGE
        for k, byte in enumerate(data):
            self.table[self.where(address + k)] = byte
        if address == OPERATING_MODE:  # a change of the mode resets what belongs to it
            self.put(GOAL_CURRENT, 2, self.get(CURRENT_LIMIT, 2))
            self.put(ACCELERATION, 4, 0)
            self.put(PROFILE_VELOCITY, 4, 0)
        if address == GOAL and self.table[DRIVE_MODE] & TORQUE_BY_GOAL:
            self.table[TORQUE] = 1
        return 0

    @property
    def moving(self) -> bool:
        return bool(self.table[TORQUE]) and self.table[WATCHDOG] != 255

    @property
    def current_max(self) -> float:
        """Largest current [counts]; the limits act in some operating modes only."""
        if self.table[OPERATING_MODE] not in LIMITING_MODES:
            return np.inf
        return min(self.get(GOAL_CURRENT, 2), self.get(CURRENT_LIMIT, 2))


class Servos(BusThread):
    """Servos with their motors' plant; `serve` runs until `ended` is set.

    Their watchdogs wait `patience` times as long as told: a busy machine holds up the driver, too.
    """

    def __init__(self, numbers=(1,), plant=None, patience: float = 10.0, link=None) -> None:
        self._patience = patience
        self.port = PseudoPort(link)
        self.servos = {number: Servo(number) for number in numbers}
        self.plant = plant or Springs(len(self.servos))
        self.lose = self.damage = 0  # answers to swallow, or to send with a wrong byte
        self.stopped_s = 0.0  # when a watchdog has triggered last, on the monotonic clock
        self.kinds = set()  # instructions that were received
        self._received = b""
        self._answers_from = 0  # status return level from which the instruction is answered
        self._start_s = time.monotonic()

    def serve(self) -> None:
        due_s = 0.0
        while not self.ended:
            data = self.port.read(0.001)
            now = time.monotonic()
            if now >= due_s:
                self._advance(now)
                due_s = now + ROUND_S
            self._received += data
            packets = []
            while (packet := self._next()) is not None:
                packets.append(packet)
            for k, packet in enumerate(packets):  # the line is not queued as a pty is
                overtaken = any(later[1] == SYNC_READ for later in packets[k + 1 :])
                if packet[1] != SYNC_READ or not overtaken:
                    self._obey(packet, now)
        self.port.unplug()

    def _advance(self, now: float) -> None:
        servos = list(self.servos.values())
        for servo in servos:
            limit_s = servo.table[WATCHDOG] * WATCHDOG_UNIT_S * self._patience
            if 0 < servo.table[WATCHDOG] < 255 and now - servo.heard_s > limit_s:
                servo.table[WATCHDOG] = 255
                self.stopped_s = now
        goals = [servo.get(GOAL, 4, signed=True) for servo in servos]
        limits = [servo.current_max for servo in servos]
        powered = [servo.moving for servo in servos]
        self.plant.advance(now - self._start_s, goals, powered, limits)
        cells = self.plant.read_cells()
        for servo, position, tension in zip(servos, self.plant.position, cells, strict=True):
            servo.put(POSITION, 4, round(position))
            servo.put(CURRENT, 2, round(min(tension, servo.current_max, 30_000)))

    def _next(self) -> bytes | None:
        """Cut the next valid packet, from its id on and without CRC, off what was received."""
        while True:
            at = self._received.find(HEADER)
            if at < 0 or len(self._received) < at + 7:
                return None
            self._received = self._received[at:]
            (length,) = struct.unpack_from("<H", self._received, 5)
            whole = self._received[: 7 + length]
            if len(whole) < 7 + length:
                return None
            self._received = self._received[7 + length :]
            if compute_crc(whole[:-2]) == struct.unpack("<H", whole[-2:])[0]:
                return whole[4:5] + whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")

    def _obey(self, packet: bytes, now: float) -> None:
        number, instruction, body = packet[0], packet[1], packet[2:]
        self.kinds.add(instruction)
        self._answers_from = {PING: 0, READ: 1, SYNC_READ: 1}.get(instruction, 2)
        if instruction == SYNC_READ:
            address, size = struct.unpack_from("<HH", body)
            for one in body[4:]:
                if one in self.servos:
                    self._hear(one, now)
                    self._answer_read(one, address, size)
        elif instruction == SYNC_WRITE:
            address, size = struct.unpack_from("<HH", body)
            for k in range(4, len(body), size + 1):
                if body[k] in self.servos:
                    self._hear(body[k], now)
                    self.servos[body[k]].write(address, body[k + 1 : k + 1 + size])
        elif number in self.servos or number == BROADCAST:
            for one in [number] if number in self.servos else list(self.servos):
                self._hear(one, now)
                self._single(one, instruction, body)

    def _hear(self, number: int, now: float) -> None:
        self.servos[number].heard_s = now

    def _single(self, number: int, instruction: int, body: bytes) -> None:
        servo = self.servos[number]
        if instruction == PING:
            self._answer(number, bytes(servo.table[0:2]) + b"\x2d")
        elif instruction == READ:
            address, size = struct.unpack_from("<HH", body)
            self._answer_read(number, address, size)
        elif instruction == WRITE:
            (address,) = struct.unpack_from("<H", body)
            self._answer(number, b"", servo.write(address, body[2:]))
        elif instruction == REBOOT:
            servo.put(TORQUE, 1, 0)
            servo.put(ERROR, 1, 0)
            servo.put(WATCHDOG, 1, 0)
            self._answer(number, b"")

    def _answer_read(self, number: int, address: int, size: int) -> None:
        data = self.servos[number].read(address, size)
        self._answer(number, data, 0 if data else DATA_RANGE)

    def _answer(self, number: int, data: bytes, error: int = 0) -> None:
        if self.servos[number].table[STATUS_RETURN] < self._answers_from:
            return
        if self.lose > 0:
            self.lose -= 1
            return
        error |= ALERT if self.servos[number].table[ERROR] else 0
        body = bytes([STATUS, error]) + data.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        whole = HEADER + bytes([number]) + struct.pack("<H", len(body) + 2) + body
        whole += struct.pack("<H", compute_crc(whole))
        if self.damage > 0:
            self.damage -= 1
            whole = whole[:-1] + bytes([whole[-1] ^ 1])
        self.port.write(whole)


def read_positions(servos: Servos):
    return np.array([servo.get(POSITION, 4, signed=True) for servo in servos.servos.values()])
