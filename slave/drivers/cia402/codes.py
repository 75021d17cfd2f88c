"""Codes of CANopen in words: emergencies (CiA 301, CiA 402) and aborts of SDO transfers."""

from canopen.sdo.exceptions import SdoAbortedError

_EMERGENCIES = {  # the more exact first: by code, then by its first two digits, then by the first
    0x2130: "short circuit",
    0x2310: "continuous over current",
    0x2320: "short circuit",
    0x2330: "earth leakage on the motor side",
    0x2340: "short circuit on the motor side",
    0x3110: "mains over voltage",
    0x3120: "mains under voltage",
    0x3130: "mains phase missing",
    0x3210: "over voltage of the power stage",
    0x3220: "under voltage of the power stage",
    0x4100: "ambient temperature",
    0x4200: "device temperature",
    0x4210: "drive too hot",
    0x4310: "drive or motor too hot",
    0x5100: "supply of the drive's electronics",
    0x5441: "enable input missing (safe torque off)",
    0x5500: "memory of the drive",
    0x6100: "firmware of the drive",
    0x6200: "program in the drive",
    0x6300: "parameters of the drive",
    0x6310: "parameters of the drive lost",
    0x6320: "wrong parameter",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor commutation",
    0x7300: "sensor",
    0x7303: "resolver 1",
    0x7304: "resolver 2",
    0x7305: "incremental encoder",
    0x7306: "incremental encoder 2",
    0x7310: "over speed",
    0x7320: "position sensor",
    0x8100: "CAN communication",
    0x8110: "CAN overrun, messages lost",
    0x8120: "CAN in error passive mode",
    0x8130: "heartbeat missing",
    0x8140: "CAN recovered from bus off",
    0x8141: "CAN recovered from bus off",
    0x8150: "CAN identifier collision",
    0x8200: "CAN protocol",
    0x8210: "PDO not processed, wrong length",
    0x8220: "PDO length exceeded: another controller, or its mapping was changed",
    0x8240: "SYNC of an unexpected length",
    0x8250: "PDO from this side missing in time",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8400: "velocity control",
    0x8500: "position control",
    0x8611: "following error",
    0x8612: "position limit exceeded",
    0x8613: "homing",
    0x8700: "synchronisation (SYNC missing or late)",
    0x9000: "external error",
    0xFF00: "of the manufacturer",
    0xF000: "of the manufacturer or additional function",
    0x1000: "generic error",
    0x2000: "over current",
    0x3000: "voltage",
    0x4000: "too hot",
    0x5000: "drive hardware",
    0x6000: "drive software",
    0x7000: "additional module or sensor",
    0x8000: "monitoring",
}


def format_emergency(code: int) -> str:
    """Return an error code in words with its number, as in 'following error (0x8611)'."""
    for group in (code, code & 0xFF00, code & 0xF000):
        if group in _EMERGENCIES:
            return f"{_EMERGENCIES[group]} (0x{code:04X})"
    return f"error 0x{code:04X}"


_ABORTS = {  # beside those of canopen
    0x06010003: "Subindex cannot be written",
    0x06010006: "Object is mapped to a PDO, which must be off first",
    0x0F00FFBC: "The drive is not in service mode",
    0x0F00FFBE: "A password is needed",
    0x0F00FFBF: "Unknown command of the maker",
    0x0F00FFC0: "The drive is in the wrong NMT state",
}
_NEXT_STEPS = {
    0x06010002: "its firmware does not let this be set: does it know this mode?",
    0x06020000: "its firmware has no such object: does it know this mode?",
    0x06040041: "its mapping is fixed: choose a mapping with these objects by its own tool",
    0x06040042: "its PDOs take fewer bytes: analogue.bits 16 needs 8 in one",
    0x06090030: "the value is beyond its range: correct the config",
    0x06090031: "the value is beyond its range: correct the config",
    0x06090032: "the value is beyond its range: correct the config",
    0x08000021: "end its own tool, which has control of it",
    0x08000022: "disable it by its own tool, or switch it off and on",
    0x0F00FFC0: "switch it off and on",
}


def format_abort(error: SdoAbortedError) -> str:
    """Return why a node has refused an SDO transfer, with the next step if one is known."""
    text = str(error)
    if error.code in _ABORTS:
        text += f", {_ABORTS[error.code]}"
    step = _NEXT_STEPS.get(error.code)
    return f"{text}: {step}" if step else text
