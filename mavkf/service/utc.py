"""UTC of a vehicle's boot clock."""


class UtcClock:
    """Offset from the boot clock to UTC, mapped one-sidedly: a report can only be late, never early.

    The largest offset heard is the one with the least delay; it leaks so that a clock that drifts is followed.
    """

    LEAK = 1e-4  # of the time passed: the drift of a cheap crystal

    def __init__(self) -> None:
        self._offset_us: float | None = None
        self._t = 0.0

    def update(self, t_boot_s: float, unix_us: float) -> None:
        """Take a report of the vehicle's UTC (microseconds; 0 or before 2000 means it does not know) at a boot time."""
        if not unix_us > 9.5e14:
            return
        offset = unix_us - t_boot_s * 1e6
        if self._offset_us is not None and abs(offset - self._offset_us) < 1e6:
            leaked = self._offset_us - self.LEAK * 1e6 * max(0.0, t_boot_s - self._t)
            offset = max(offset, leaked)
        self._offset_us, self._t = offset, t_boot_s

    def __call__(self, t_boot_s: float) -> int | None:
        """Nanoseconds UTC of a boot time (s), None while unknown."""
        return None if self._offset_us is None else round((t_boot_s * 1e6 + self._offset_us) * 1e3)
