"""Send columns of rows and static data to Rerun."""

from collections.abc import Iterable

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import AsComponents

from teleop.view.batch import Rows
from teleop.view.columns import Stamps


class Sender:
    """A Rerun stream that takes blocks of rows, and remembers which entities have their style."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._styled: set[str] = set()
        self.newest_ns = 0  # [ns] the newest stamp sent

    def columns(self, path: str, rows: Rows, columns: Iterable[rr.ComponentColumn]) -> None:
        """Send `columns`, one row at the stamp of each of `rows`."""
        if len(rows) == 0:
            return
        self.columns_at(path, rows["stamp_ns"], columns)

    def columns_at(
        self, path: str, stamps_ns: NDArray[np.int64], columns: Iterable[rr.ComponentColumn]
    ) -> None:
        """Send `columns`, one row at each stamp [ns since the epoch]."""
        self._stream.send_columns(path, [Stamps(stamps_ns)], columns)
        self.newest_ns = max(self.newest_ns, int(stamps_ns.max(initial=0)))

    def static(self, path: str, archetype: AsComponents) -> None:
        """Send static data, replacing earlier ones."""
        self._stream.log(path, archetype, static=True)

    def once(self, path: str, archetype: AsComponents) -> None:
        """Send static data, if none were sent for this entity."""
        if path not in self._styled:
            self._styled.add(path)
            self.static(path, archetype)

    def styled(self, path: str) -> bool:
        """Return whether static data were sent for this entity."""
        return path in self._styled

    def restyle(self) -> None:
        """Reset, so that static data are sent again."""
        self._styled.clear()
