"""The phases of the initialisation: motor speeds and end condition of each.

Every handler returns the speeds [m/s] of the joint's motors and the new state, which may be at the
start of another phase, or raises `ProcedureRefused`.
"""

import math
from collections.abc import Callable

from slave.calibration import procedure_state
from slave.calibration.config import InitialiseConfig
from slave.calibration.procedure_state import (
    JointConstants,
    JointReadings,
    Phase,
    ProcedureRefused,
    ProcedureState,
    StopContact,
    Tendons,
    Trend,
    begin_phase,
    format_tendon_name,
)

TREND_WINDOW = 2e-4  # [m] of motor travel for the stiffness estimate
TENSION_GAIN = 0.004  # [m/s] of winding per [N] of missing tension
DEAD_BAND_LOW, DEAD_BAND_HIGH = 0.7, 1.3  # times the wanted tension: between them the motor rests
TAKE_UP_BAND_HIGH = 3.0  # times the take-up tension; friction near the motor allows nothing finer
SLACK_SPEED = 0.25  # of the seek speed: winding speed of a slack tendon
SETTLING_S = 0.05  # [s] for which tensions must stay in their range before the next phase
TAUT_RATIO = 0.2  # of the wanted tension; below it a tendon counts as slack
TENSION_RISE_MIN = 0.25  # of the target tension: least rise after contact with the stop
LEFT_STOP_RATIO = 20.0  # times the compliance of the pull: the joint has left its stop
# of the highest tension of a pull; below it the tendon has slipped or broken
TENSION_LOSS_RATIO = 0.3
PROBE_INTERVAL = 5e-4  # [m] of travel before a working load cell is tested again
PROBE_TRAVEL = 1e-5  # [m] to go back for the test
PROBE_S = 0.2  # [s] in which the cell must respond
TRAVEL_MARGIN = 1.5  # times the expected travel of a pull or release
TRAVEL_ALLOWANCE = 5e-4  # [m] added to that
DRAG_OVERSHOOT = 0.4  # of the range beyond the middle: end of the first of two drags
LEAD_SHARE = 0.15  # of a drag, until both tendons slide
DRAG_PEAK = 0.9  # of the target tension: where the tension of a drag turns
# times the stretch of the pulled tendon at the peak: about that of both together
STRETCH_RATIO = 1.5
POSTURE_ERROR = 1e-3  # [m] of a stop that was found before
OBSTACLE_RATIO = 0.4  # of the target tension; a joint moves freely below it
SPEED_SHARE_MAX = 0.8  # of the speed: largest difference between paying out and drawing

PhaseResult = tuple[Tendons, ProcedureState]


def _take_up_slack(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Wind in every tendon until it is just taut."""
    count = len(sample.tension)
    if memory.steady >= SETTLING_S:
        if memory.phase is Phase.SETTLE:
            return _enter_phase(memory, Phase.DONE, sample)
        if not memory.home:
            memory = memory._replace(home=sample.travel)
        if joint.is_staged:
            return _enter_phase(memory, Phase.HOLD, sample)
        if memory.side == count:
            memory = memory._replace(lane=_compute_drag_length(config, memory, sample))
        phase = Phase.SEEK if memory.side < count else Phase.DRAG
        return _enter_phase(memory, phase, sample)
    wound = [q - q0 for q, q0 in zip(sample.travel, memory.origin, strict=True)]
    allowed = config.slack_max + (config.pay_out + TREND_WINDOW if memory.stops else 0.0)
    if sum(wound) > allowed:
        loosest = min(range(count), key=lambda k: memory.tension[k])
        name = format_tendon_name(joint.number, count, loosest)
        if memory.tension[loosest] > TAUT_RATIO * config.take_up or sum(wound) > 2.0 * allowed:
            tension = memory.tension[loosest]
            raise ProcedureRefused(
                _explain_slack(config, name, tension, sum(wound), config.take_up)
            )
    tightest = min(range(count), key=wound.__getitem__)
    if wound[tightest] < -allowed:
        name = format_tendon_name(joint.number, count, tightest)
        raise ProcedureRefused(
            f"{name}: still {memory.tension[tightest]:.2f} N after paying out "
            f"{-wound[tightest] * 1e3:.1f} mm; something pulls on the joint, or one of its load "
            "cells is stuck or not tared; check both",
        )
    return _take_up(config, memory), memory


def _take_up(config: InitialiseConfig, memory: ProcedureState) -> Tendons:
    """Return the speeds at which all tendons get near the take-up tension."""
    return tuple(
        compute_holding_speed(config, tension, config.take_up, TAKE_UP_BAND_HIGH, 0.0)
        for tension in memory.tension
    )


def _seek_stop(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Pull one tendon until the joint is at its stop and the tension is reached."""
    k, count = memory.side, len(sample.tension)
    name = format_tendon_name(joint.number, count, k)
    tension, travel = memory.tension[k], sample.travel[k]
    line = _update_line(memory, sample, k, 1.0)
    stretching = procedure_state.compute_stiffness(line, TREND_WINDOW) * joint.compliance[k] >= 1.0
    contact = memory.contact
    if contact is None or not stretching:
        contact = StopContact(travel, tension)
    memory = memory._replace(trend=line, contact=contact)
    if tension >= config.tension:
        return _accept_stop(config, joint.compliance[k], name, memory, sample)
    wound = travel - memory.origin[k]
    if wound > config.travel_max:
        remedy = "check that the tendon is attached, or raise slave.initialise.travel_max"
        text = f"no stop within {config.travel_max * 1e3:g} mm, the tension is {tension:.2f} N"
        if travel - memory.cells[k].since > 0.5 * wound:
            text, remedy = f"{text}, and the reading never changes", "check the load cell"
        raise ProcedureRefused(f"{name}: {text}; {remedy}")
    if _has_lost_tension(config, memory, tension):
        raise ProcedureRefused(_explain_loss(name, memory.highest, tension))
    if travel > memory.tried + PROBE_INTERVAL and procedure_state.is_cell_stuck(
        memory.cells[k], travel
    ):
        return _enter_phase(memory, Phase.PROBE, sample)
    speed = config.stretch_speed if stretching else config.seek_speed
    return _draw_joint(config, joint, memory, sample, k, speed), memory


def _accept_stop(
    config: InitialiseConfig,
    softest: float,
    name: str,
    memory: ProcedureState,
    sample: JointReadings,
) -> PhaseResult:
    """Accept the end of the search as a stop, unless it is implausible."""
    k, contact = memory.side, memory.contact
    assert contact is not None  # noqa: S101 - set by the caller
    rise = memory.tension[k] - contact.tension
    if rise < TENSION_RISE_MIN * config.tension:
        raise ProcedureRefused(
            f"{name}: {memory.tension[k]:.1f} N were reached before or just after the stop "
            f"({contact.tension:.1f} N): the tip presses on something soft, or friction, spring "
            "and the other tendon take all the tension; free the tip, or raise "
            "slave.initialise.tension",
        )
    compliance = (sample.travel[k] - contact.travel) / rise
    if compliance > softest:
        raise ProcedureRefused(
            f"{name}: beyond {contact.tension:.1f} N it yields by {compliance * 1e3:.3f} mm/N, "
            f"more than any sheath of this rig ({softest * 1e3:.3f} mm/N): the tip presses on "
            "something soft; free it",
        )
    stops = (*memory.stops, contact._replace(compliance=compliance))
    next_phase = Phase.SLACKEN if len(sample.tension) > 1 else Phase.RELEASE
    return _enter_phase(memory._replace(stops=stops, releases=0), next_phase, sample)


def _probe_cell(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Go back a little to test whether the load cell responds."""
    k = memory.side
    if memory.cells[k].alike == 0:
        memory = memory._replace(tried=sample.travel[k])
        return _enter_phase(memory, Phase.SEEK, sample)
    if memory.elapsed > PROBE_S:
        name = format_tendon_name(joint.number, len(sample.tension), k)
        raise ProcedureRefused(_explain_stuck_cell(name, memory.tension[k]))
    is_back = sample.motor[k] > memory.origin[k] - PROBE_TRAVEL
    return _build_single_speed(sample, k, -config.stretch_speed if is_back else 0.0), memory


def _slacken_antagonist(
    config: InitialiseConfig, _joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Pay out the other tendon until it cannot pull the joint off its stop."""
    antagonist = 1 - memory.side
    if memory.origin[antagonist] - sample.travel[antagonist] >= config.pay_out:
        return _enter_phase(memory, Phase.RELEASE, sample)
    return _build_single_speed(sample, antagonist, -config.seek_speed), memory


def _release_tendon(
    config: InitialiseConfig, _joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Release one tendon until its tension is low or the joint leaves the stop."""
    k = memory.side
    line = _update_line(memory, sample, k, -1.0)
    memory = memory._replace(trend=line)
    releases_left = (
        procedure_state.compute_stiffness(line, TREND_WINDOW)
        * memory.stops[k].compliance
        * LEFT_STOP_RATIO
        < 1.0
    )
    enough = _compute_travel_max(config, memory)
    released = memory.origin[k] - sample.travel[k]
    if not (memory.tension[k] <= config.low or releases_left or released > enough):
        return _build_single_speed(sample, k, -_compute_stretch_speed(config, memory)), memory
    memory = memory._replace(releases=memory.releases + 1)
    if memory.releases <= config.loops:
        return _enter_phase(memory, Phase.PULL, sample)
    memory = memory._replace(side=memory.side + 1, contact=None, tried=-math.inf)
    if len(sample.tension) == 1:
        return _enter_phase(memory, Phase.RETURN, sample)
    return _enter_phase(memory, Phase.TAKE_UP, sample)


def _pull_tendon(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Pull one tendon against the stop again."""
    k = memory.side
    tension, wound = memory.tension[k], sample.travel[k] - memory.origin[k]
    if tension >= config.tension:
        return _enter_phase(memory, Phase.RELEASE, sample)
    name = format_tendon_name(joint.number, len(sample.tension), k)
    if procedure_state.is_cell_stuck(memory.cells[k], sample.travel[k]):
        raise ProcedureRefused(_explain_stuck_cell(name, tension))
    if _has_lost_tension(config, memory, tension):
        raise ProcedureRefused(_explain_loss(name, memory.highest, tension))
    if wound > _compute_travel_max(config, memory):
        if tension < TAUT_RATIO * config.take_up:
            raise ProcedureRefused(_explain_loss(name, config.tension, tension))
        raise ProcedureRefused(
            f"{name}: the later pull reached only {tension:.1f} N, not {config.tension:g} N: the "
            "stop yields or the tendon slips; check both",
        )
    return _build_single_speed(sample, k, _compute_stretch_speed(config, memory)), memory


def _drag_tendon(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Pull one tendon at one speed while the tension of the other one rises, and falls again.

    The other tendon is paid out more slowly than it is drawn, then faster: both keep sliding in one
    direction, and the joint's own resistance is the same with rising and falling tension.
    """
    k = memory.side % 2
    tension, wound = memory.tension[k], sample.travel[k] - memory.origin[k]
    if tension >= config.tension:
        raise ProcedureRefused(
            f"joint {joint.number}: {tension:.1f} N on the way back from the stop, where the joint "
            "moved freely before: remove the obstacle",
        )
    if wound >= memory.lane:
        if joint.is_staged:
            return _enter_phase(memory, Phase.HOLD, sample)
        if memory.side + 1 < 2 + config.drags:
            lane = memory.lane * DRAG_OVERSHOOT / (0.5 + DRAG_OVERSHOOT)
            memory = memory._replace(side=memory.side + 1, lane=lane, easing=False)
            return _enter_phase(memory, Phase.DRAG, sample)
        return _enter_phase(memory, Phase.SETTLE, sample)
    speed = min(config.seek_speed, memory.lane / config.drag_time)
    if wound < LEAD_SHARE * memory.lane or (memory.easing and memory.tension[1 - k] <= config.keep):
        return _draw_joint(config, joint, memory, sample, k, speed), memory
    peak = DRAG_PEAK * config.tension
    if tension >= peak or wound > (0.5 + 0.5 * LEAD_SHARE) * memory.lane:
        memory = memory._replace(easing=True)
    stretch = STRETCH_RATIO * memory.stops[k].compliance * peak
    share = min(stretch / (0.5 * (1.0 - LEAD_SHARE) * memory.lane), SPEED_SHARE_MAX)
    drawn = speed * (1.0 + share if memory.easing else 1.0 - share)
    return ((speed, -drawn) if k == 0 else (-drawn, speed)), memory


def _move_joint(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Let one tendon move the joint by `lane`, or press it to its stop with `hold`."""
    k = memory.side
    if not memory.easing:  # a tendon that held it at a stop would brake it
        if memory.steady >= SETTLING_S:
            return _enter_phase(memory._replace(easing=True), Phase.MOVE, sample)
        return _take_up(config, memory), memory
    tension, left = memory.tension[k], memory.lane
    if tension >= memory.hold if memory.hold else left <= 0.0:
        if left <= POSTURE_ERROR:
            return _enter_phase(memory, Phase.HOLD, sample)
    elif left > -POSTURE_ERROR and tension < max(memory.hold, OBSTACLE_RATIO * config.tension):
        speed = config.stretch_speed if left < POSTURE_ERROR else config.seek_speed
        return _draw_joint(config, joint, memory, sample, k, speed), memory
    where = f"{left * 1e3:.1f} mm before" if left > 0.0 else f"{-left * 1e3:.1f} mm beyond"
    raise ProcedureRefused(
        f"joint {joint.number}: posture not reached: {tension:.1f} N {where} its place; free the "
        "tip and the links, and check its stops and arms.radii",
    )


def _compute_drag_length(
    config: InitialiseConfig, memory: ProcedureState, sample: JointReadings
) -> float:
    """Return the length [m] of the first drag: to the middle, or such that the next ends there."""
    reach = memory.stops[0].travel - sample.travel[0]
    return reach * (0.5 + (DRAG_OVERSHOOT if config.drags > 1 else 0.0))


def _return_joint(
    config: InitialiseConfig, _joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Let a return spring take the joint back to where it came from."""
    if sample.travel[0] <= memory.home[0]:
        return _enter_phase(memory, Phase.SETTLE, sample)
    return _build_single_speed(sample, 0, -config.seek_speed), memory


def _lower_tensions(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    """Lower all tensions slowly; wind in nothing and pay out no more than needed."""
    if memory.steady >= SETTLING_S or memory.elapsed > config.relax_max:
        return _enter_phase(memory, Phase.REFUSED, sample)
    speeds = []
    for k, tension in enumerate(memory.tension):
        travel_max = TRAVEL_MARGIN * joint.compliance[k] * config.tension + TRAVEL_ALLOWANCE
        tight = (
            tension > compute_relaxed_tension(config)
            and memory.origin[k] - sample.motor[k] < travel_max
        )
        speeds.append(-0.5 * config.seek_speed if tight else 0.0)
    return tuple(speeds), memory


def _hold_motors(
    _config: InitialiseConfig, _joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> PhaseResult:
    return _build_zero_speeds(sample), memory


def _explain_slack(
    config: InitialiseConfig, name: str, tension: float, wound: float, tension_target: float
) -> str:
    if tension > TAUT_RATIO * tension_target:
        return (
            f"{name}: {wound * 1e3:.1f} mm had to be wound in before it was taut, more than "
            f"slave.initialise.slack_max ({config.slack_max * 1e3:g} mm); shorten the tendon"
        )
    return (
        f"{name}: {tension:.2f} N after winding in {wound * 1e3:.1f} mm; the tendon is broken, too "
        "slack or not attached, or its load cell is stuck; check both"
    )


def _has_lost_tension(config: InitialiseConfig, memory: ProcedureState, tension: float) -> bool:
    """Return whether the tendon that is pulled has slipped or broken."""
    is_low = tension < TENSION_LOSS_RATIO * memory.highest
    return is_low and memory.highest > TENSION_RISE_MIN * config.tension


def _explain_loss(name: str, highest: float, tension: float) -> str:
    return (
        f"{name}: the tension was {highest:.1f} N and is {tension:.1f} N although the motor pulls: "
        "the tendon slipped or broke"
    )


def _explain_stuck_cell(name: str, tension: float) -> str:
    return (
        f"{name}: the load cell reads {tension:.2f} N without any change while the motor pulls: it "
        "is stuck or saturated; check its cable and amplifier, or lower slave.initialise.tension"
    )


def _enter_phase(memory: ProcedureState, phase: Phase, sample: JointReadings) -> PhaseResult:
    return _build_zero_speeds(sample), begin_phase(memory, phase, sample)


def _build_zero_speeds(sample: JointReadings) -> Tendons:
    return (0.0,) * len(sample.motor)


def _build_single_speed(sample: JointReadings, tendon: int, speed: float) -> Tendons:
    return tuple(speed if k == tendon else 0.0 for k in range(len(sample.motor)))


def _update_line(memory: ProcedureState, sample: JointReadings, k: int, direction: float) -> Trend:
    if memory.trend is None:
        return procedure_state.init_trend(sample.travel[k], sample.tension[k])
    return procedure_state.update_trend(
        memory.trend, sample.travel[k], sample.tension[k], direction, TREND_WINDOW
    )


def _compute_travel_max(config: InitialiseConfig, memory: ProcedureState) -> float:
    """Return the largest motor travel [m] of a whole pull or release."""
    return TRAVEL_MARGIN * memory.stops[memory.side].compliance * config.tension + TRAVEL_ALLOWANCE


def _compute_stretch_speed(config: InitialiseConfig, memory: ProcedureState) -> float:
    """Return the speed [m/s] for a pull or release of duration `stretch_time`."""
    return memory.stops[memory.side].compliance * config.tension / config.stretch_time


def compute_holding_speed(
    config: InitialiseConfig, tension: float, target: float, tight: float, along: float
) -> float:
    """Return the speed [m/s] that keeps a tendon near `target` [N] while its end moves by `along`.

    No control between `DEAD_BAND_LOW` and `tight` times that tension.
    """
    if tension < TAUT_RATIO * target:
        return along + SLACK_SPEED * config.seek_speed
    is_in_band = DEAD_BAND_LOW * target <= tension <= tight * target
    speed = 0.0 if is_in_band else TENSION_GAIN * (target - tension)
    return min(max(along + speed, -2.0 * config.seek_speed), config.seek_speed)


def _draw_joint(
    config: InitialiseConfig,
    joint: JointConstants,
    memory: ProcedureState,
    sample: JointReadings,
    k: int,
    speed: float,
) -> Tendons:
    """Pull tendon `k` at `speed`; pay the other one out as fast and keep it just taut.

    As fast even while the joint rests: if it lagged, the joint would have to draw it out with e^K
    times its tension at the housing.
    """
    if len(sample.tension) == 1:
        return (speed,)
    antagonist = 1 - k
    wound = sample.travel[antagonist] - memory.lowest
    if wound > config.slack_max and memory.tension[antagonist] < TAUT_RATIO * config.keep:
        name = format_tendon_name(joint.number, 2, antagonist)
        tension = memory.tension[antagonist]
        raise ProcedureRefused(_explain_slack(config, name, tension, wound, config.keep))
    holding_speed = compute_holding_speed(
        config, memory.tension[antagonist], config.keep, DEAD_BAND_HIGH, -speed
    )
    return (speed, holding_speed) if k == 0 else (holding_speed, speed)


def is_settled(config: InitialiseConfig, phase: Phase, tension: Tendons) -> bool:
    """Return whether all tendons have the target tension of this phase."""
    if phase is Phase.RELAX:
        return max(tension) <= compute_relaxed_tension(config)
    if phase not in (Phase.TAKE_UP, Phase.SETTLE, Phase.MOVE):
        return False
    low, high = 0.9 * DEAD_BAND_LOW * config.take_up, 1.1 * TAKE_UP_BAND_HIGH * config.take_up
    return all(low <= t <= high for t in tension)


def compute_relaxed_tension(config: InitialiseConfig) -> float:
    """Return the tension [N] to which tendons are released after an abort."""
    return 2.0 * max(config.low, config.take_up)


HANDLERS: dict[
    Phase, Callable[[InitialiseConfig, JointConstants, ProcedureState, JointReadings], PhaseResult]
] = {
    Phase.TAKE_UP: _take_up_slack,
    Phase.SEEK: _seek_stop,
    Phase.PROBE: _probe_cell,
    Phase.SLACKEN: _slacken_antagonist,
    Phase.RELEASE: _release_tendon,
    Phase.PULL: _pull_tendon,
    Phase.DRAG: _drag_tendon,
    Phase.RETURN: _return_joint,
    Phase.SETTLE: _take_up_slack,
    Phase.DONE: _hold_motors,
    Phase.RELAX: _lower_tensions,
    Phase.REFUSED: _hold_motors,
    Phase.MOVE: _move_joint,
    Phase.HOLD: _hold_motors,
}
