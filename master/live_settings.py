"""Settings that may change while the master runs, with bumpless transfer.

A position scale and a lock act at once: the operator re-anchors hand and tip. A force scale ramps
to its new value in `SLEW_S`. Nothing else may change on this side (`slave.live_settings`).
"""

import re
from dataclasses import replace
from typing import NamedTuple

from master.config import MasterConfig
from master.device import HandState
from teleop.config.suggestions import suggest_spelling
from teleop.errors import UsageError

SLEW_S = 0.5  # [s] ramp of the force scale
BUTTON_FACTOR = 2.0**0.5  # factor of a button press
SCALE_RANGE = (0.01, 1.0)  # range for buttons
KEYS = ("force.scale", "operator.lock", "operator.position_scale")
BUTTONS = (  # that decrease and increase a scale
    ("operator.position_scale", "finer", "coarser"),
    ("force.scale", "weaker", "stronger"),
)


RELEASED = (False, False)


class LiveSettings(NamedTuple):
    """The active config and the target of its force scale."""

    config: MasterConfig
    force_scale: float
    rate: float = 0.0  # [1/s] of the ramp
    held: tuple[bool, ...] = RELEASED  # whether one of `BUTTONS` is held, for each scale

    @property
    def settled(self) -> bool:
        """Whether no ramp is active."""
        return self.config.force.scale == self.force_scale


def init_settings(config: MasterConfig) -> LiveSettings:
    """Return the initial settings."""
    return LiveSettings(config, config.force.scale)


def change_setting(live: LiveSettings, key: str, value: str) -> tuple[LiveSettings, str]:
    """Return the settings with one of `KEYS` set to `value`, and the value as text.

    `UsageError` if the key cannot be changed while the master runs, or not to this value.
    """
    name = key.removeprefix("master.")
    if name not in KEYS:
        meant = suggest_spelling(name, KEYS, cutoff=0.75)
        what = f"is unknown{meant}" if meant else "cannot be changed while the master runs"
        raise UsageError(f"{key}: {what} (allowed: {', '.join(KEYS)})")
    config = live.config
    try:
        if name == "force.scale":
            wanted = replace(config.force, scale=_parse_number("scale", value)).scale
            gap = abs(wanted - config.force.scale)
            return live._replace(force_scale=wanted, rate=gap / SLEW_S), f"{name} = {wanted:g}"
        if name == "operator.lock":
            operator = replace(config.operator, lock=_parse_axes(value))
            text = str(list(operator.lock))
        else:
            operator = replace(
                config.operator, position_scale=_parse_number("position_scale", value)
            )
            text = f"{operator.position_scale:g}"
    except ValueError as error:
        raise UsageError(f"master.{name.partition('.')[0]}.{error}") from error
    return live._replace(config=replace(config, operator=operator)), f"{name} = {text}"


def _parse_number(field: str, text: str) -> float:
    """Parse a number; called in the loop, so it must be fast."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{field}: expected a number, got {text!r}") from None


def _parse_axes(text: str) -> tuple[int, ...]:
    if not re.fullmatch(r"\s*(\[\s*(\d\s*(,\s*\d\s*)*)?\]|\d)\s*", text, re.ASCII):
        raise ValueError(f"lock: expected axes as in '[0, 2]', got {text!r}")
    return tuple(int(digit) for digit in re.findall(r"\d", text, re.ASCII))


def update_settings(
    live: LiveSettings, hand: HandState | None, dt: float
) -> tuple[LiveSettings, str]:
    """Return the settings of a tick, `dt` [s] after the last, and a text of button changes.

    Fast while nothing changes.
    """
    resting = live.config.force.scale == live.force_scale and live.held == RELEASED
    if resting and (
        hand is None or not (hand.finer or hand.coarser or hand.weaker or hand.stronger)
    ):
        return live, ""
    return apply_buttons(advance_ramp(live, dt), hand)


def apply_buttons(live: LiveSettings, hand: HandState | None) -> tuple[LiveSettings, str]:
    """Return the settings after the device's buttons, and a text of the changes.

    A press counts once; both buttons of a scale together are ignored.
    """
    if hand is None:
        return live, ""
    down = [(getattr(hand, less), getattr(hand, more)) for _, less, more in BUTTONS]
    held, before = tuple(map(any, down)), live.held
    if held == before:
        return live, ""
    live, changes = live._replace(held=held), []
    for (key, *_), (less, more), was in zip(BUTTONS, down, before, strict=True):
        if less != more and not was:
            is_force = key == "force.scale"
            scale = live.force_scale if is_force else live.config.operator.position_scale
            live, words = change_setting(live, key, f"{_step_scale(scale, less):.6g}")
            changes.append(words)
    return live, ", ".join(changes)


def scale_config(config: MasterConfig, scale: float) -> MasterConfig:
    """Return `config` with the force scale and the position scale times `scale`."""
    force = replace(config.force, scale=config.force.scale * scale)
    position_scale = config.operator.position_scale * scale
    operator = replace(config.operator, position_scale=position_scale)
    return replace(config, force=force, operator=operator)


def _step_scale(now: float, less: bool) -> float:
    low, high = min(SCALE_RANGE[0], now), max(SCALE_RANGE[1], now)
    return min(max(now / BUTTON_FACTOR if less else now * BUTTON_FACTOR, low), high)


def advance_ramp(live: LiveSettings, dt: float) -> LiveSettings:
    """Return the settings of a tick, `dt` [s] after the last."""
    if live.settled:
        return live
    now, reach = live.config.force.scale, live.rate * dt
    scale = min(max(live.force_scale, now - reach), now + reach)
    return live._replace(config=replace(live.config, force=replace(live.config.force, scale=scale)))
