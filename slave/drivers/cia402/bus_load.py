"""Share of a CAN bus that cyclic PDOs take."""

LOAD_MAX = 0.95
HEARTBEATS_HZ = 110.0  # ours, every 10 ms, and one a node every 100 ms


def compute_frame_bits(data: int) -> int:
    """Return the most bits of a frame with 11-bit identifier and `data` bytes, stuffing included.

    44 bits of frame and 3 of interframe space; one stuff bit for every four of the 34 + 8 data bits
    that are stuffed, less one (Tindell, Burns 1994; Davis et al. 2007).
    """
    stuffed = 34 + 8 * data
    return 47 + 8 * data + (stuffed - 1) // 4


def compute_bus_load(
    bitrate: float,
    rate_hz: float,
    drives: int,
    cells: int,
    together: int,
    wide: bool,
    beats_hz: float = HEARTBEATS_HZ,
) -> float:
    """Return the share of the bus in use in the worst case.

    Each cycle carries a SYNC, a PDO of control word and target to each drive, one of status word
    and position back, and the cells' values: of 16 bits beside a drive's own, otherwise in a PDO of
    their own.

    Parameters
    ----------
    bitrate : float
        [bit/s]
    rate_hz : float
        Of SYNC.
    drives, cells, together : int
        Nodes with a motor, with a cell, and with both.
    wide : bool
        Whether a cell's value has 32 bits.
    beats_hz : float
        Frames a second of NMT error control: heartbeats, or node guarding.
    """
    width = 4 if wide else 2
    shared = 0 if wide else together
    cycle = compute_frame_bits(0) + drives * compute_frame_bits(6)
    cycle += (drives - shared) * compute_frame_bits(6) + shared * compute_frame_bits(6 + width)
    cycle += (cells - shared) * compute_frame_bits(width)
    return (cycle * rate_hz + beats_hz * compute_frame_bits(1)) / bitrate
