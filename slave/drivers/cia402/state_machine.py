"""The state machine of CiA 402 (IEC 61800-7-201): status word in, control word out."""

from enum import Enum, IntEnum


class DriveState(Enum):
    """States of a drive; the value is (mask, pattern) of the status word."""

    NOT_READY = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY_TO_SWITCH_ON = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    OPERATION_ENABLED = (0x6F, 0x27)
    QUICK_STOP_ACTIVE = (0x6F, 0x07)
    FAULT_REACTION = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)

    @property
    def text(self) -> str:
        """Name for messages."""
        return self.name.replace("_", " ").lower()


class ControlWord(IntEnum):
    """Control words."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    RESET_FAULT = 0x80


class RequestedState(Enum):
    """What a drive is wanted to do."""

    OFF = 0  # without power
    MOVE = 1  # follow targets
    STOP = 2  # stop by its own ramp and hold


FOLLOWING_ERROR = 1 << 13  # of the status word, in the modes used here
INTERPOLATE = 1 << 4  # of the control word, in interpolated mode

_TO_MOVE = {
    DriveState.SWITCH_ON_DISABLED: ControlWord.SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: ControlWord.SWITCH_ON,
    DriveState.SWITCHED_ON: ControlWord.ENABLE_OPERATION,
    DriveState.OPERATION_ENABLED: ControlWord.ENABLE_OPERATION,
    DriveState.QUICK_STOP_ACTIVE: ControlWord.DISABLE_VOLTAGE,
}


def decode_drive_state(status_word: int) -> DriveState:
    """Return the state that a status word tells."""
    for state in DriveState:
        mask, pattern = state.value
        if status_word & mask == pattern:
            return state
    return DriveState.NOT_READY


def select_control_word(state: DriveState, requested: RequestedState) -> int:
    """Return the control word that takes a drive one step towards what is wanted.

    A fault is never reset here: that is the operator's.
    """
    if requested is RequestedState.MOVE:
        return int(_TO_MOVE.get(state, ControlWord.DISABLE_VOLTAGE))
    if requested is RequestedState.STOP and state in (
        DriveState.OPERATION_ENABLED,
        DriveState.QUICK_STOP_ACTIVE,
    ):
        return int(ControlWord.QUICK_STOP)
    return int(ControlWord.DISABLE_VOLTAGE)
