"""Emergency messages (CiA 301, CiA 402) in words."""

_TEXTS = {  # the more exact first: by code, then by its first two digits, then by the first
    0x2310: "continuous over current",
    0x2320: "short circuit",
    0x2340: "short circuit on the motor side",
    0x3110: "mains over voltage",
    0x3120: "mains under voltage",
    0x3210: "over voltage of the power stage",
    0x3220: "under voltage of the power stage",
    0x4210: "drive too hot",
    0x4310: "drive or motor too hot",
    0x5441: "enable input missing (safe torque off)",
    0x6320: "wrong parameter",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7305: "incremental encoder",
    0x7310: "over speed",
    0x7320: "position sensor",
    0x8110: "CAN overrun, messages lost",
    0x8120: "CAN in error passive mode",
    0x8130: "heartbeat missing",
    0x8140: "CAN recovered from bus off",
    0x8141: "CAN recovered from bus off",
    0x8150: "CAN identifier collision",
    0x8210: "PDO not processed, wrong length",
    0x8611: "following error",
    0x8612: "position limit exceeded",
    0x8613: "homing",
    0x2000: "over current",
    0x3000: "voltage",
    0x4000: "too hot",
    0x5000: "drive hardware",
    0x6000: "drive software",
    0x7000: "additional module or sensor",
    0x8000: "monitoring",
    0x9000: "external error",
    0xF000: "of the manufacturer",
    0x1000: "generic error",
}


def format_emergency(code: int) -> str:
    """Return an error code in words with its number, as in 'following error (0x8611)'."""
    for known in (code, code & 0xFF00, code & 0xF000):
        if known in _TEXTS:
            return f"{_TEXTS[known]} (0x{code:04X})"
    return f"error 0x{code:04X}"
