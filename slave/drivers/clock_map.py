"""Times of a device's own clock on the machine's clock."""

DRIFT = 200e-6  # largest relative error of the device's crystal
WRAP = 1 << 32  # [us] of the device's clock


class ClockMap:
    """Maps a device's clock of microseconds, 32 bits wide, to the machine's monotonic clock [s].

    A frame arrives at `sampled + offset + delay` with a delay of at least zero, so the least
    difference of arrival and device time is the best estimate of the offset. It may grow by `DRIFT`
    since crystals differ.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._unwrapped_us = 0

    def __call__(self, device_us: int, arrival_s: float) -> float:
        """Return the time [s] at which a frame with this device time was sampled."""
        if self._offset_s is None:
            self._unwrapped_us = device_us
            self._offset_s = arrival_s - device_us * 1e-6
            return arrival_s
        elapsed_us = (device_us - self._unwrapped_us) % WRAP
        self._unwrapped_us += elapsed_us
        device_s = self._unwrapped_us * 1e-6
        grown = self._offset_s + elapsed_us * 1e-6 * DRIFT
        self._offset_s = min(grown, arrival_s - device_s)
        return device_s + self._offset_s
