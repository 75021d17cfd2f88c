"""The master's end of a coupling of another package, in the master's tick."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimator.array_types import Array
from estimator.structs import StructArray
from master import loop
from teleop.config.extension_calls import CheckedExtension
from teleop.coupling.extension import FORCE_MAX, SIGNAL_MAX, CouplingExtension, HandPort
from teleop.messages.messages import MAX_JOINTS


class HandEnd:
    """Calls a `MasterCoupling`, and checks what it returns; `UsageError` if it cannot be opened.

    `memories`, `settings` and `states`, shape (1,), are `MasterMemory`, `MasterSettings` and the
    newest `SlaveState`.
    """

    def __init__(
        self,
        config: CouplingExtension,
        memories: StructArray,
        settings: StructArray,
        states: StructArray,
    ) -> None:
        n = self._joints = int(memories["joints"][0])
        self._memories, self._states = memories, states
        self._checked = CheckedExtension(
            "coupling", config, lambda: config.open_master(n), "send", "render"
        )
        self.calls = self._checked.calls
        self._was_coupled, self._sent = False, np.zeros(0)
        loop.compute_tip_forces(settings, states, False, n, np.zeros(MAX_JOINTS))  # compile it

    @property
    def _is_coupled(self) -> bool:
        return bool(self._memories["has_counted_work"][0])

    def start_tick(self) -> None:
        """Let `send` be called once more."""
        self._was_coupled, self._sent = self._is_coupled, np.zeros(0)

    def compute_command(
        self, compute: Callable[..., None], commands: StructArray, *inputs: Any
    ) -> None:
        """Run the first phase of a tick, and write the numbers for the slave; `ExtensionFault`.

        Computed again after a stall, a tick takes what was sent before.
        """
        compute(*inputs)
        n, dt = self._joints, inputs[-1]
        commands["wave"][0, :n] = 0.0
        if not self._is_coupled:
            return
        if not len(self._sent):
            side = self._memories["coupling"][0]
            hand = side["hand"][:n]
            copies = (side["requested"][:n], hand["velocity"], hand["written"])
            port = HandPort(dt, not self._was_coupled, *(values.copy() for values in copies))
            sent = self._checked.call("send", port)
            self._sent = self._checked.check("send", "sent", sent, n, SIGNAL_MAX, "")
        commands["wave"][0, :n] = self._sent

    def render(self, settings: StructArray, has_state: bool) -> None:
        """Write the forces for the hand into the memory; `ExtensionFault`."""
        n, force = self._joints, np.zeros(MAX_JOINTS)
        loop.compute_tip_forces(settings, self._states, has_state, n, force)
        received: Array = self._states["wave"][0, :n].copy()
        if self._is_coupled and np.isfinite(force).all() and np.isfinite(received).all():
            rendered = self._checked.call("render", force[:n].copy(), received)
            checked = self._checked.check("render", "force", rendered, n, FORCE_MAX, "N")
            self._memories["coupling"]["own_force"][0, :n] = checked
        else:  # refused, or not rendered
            self._memories["coupling"]["own_force"][0, :n] = 0.0
