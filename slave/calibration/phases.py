"""The phases of the initialisation: motor speeds and end condition of each.

Every handler returns the speeds [m/s] of the joint's motors and the new state, which may be at the
start of another phase.
"""

import math
from collections.abc import Callable

from slave.calibration import cell, refusals, trend
from slave.calibration.config import InitialiseConfig
from slave.calibration.procedure_state import (
    Contact,
    Joint,
    JointReadings,
    Phase,
    ProcedureState,
    Tendons,
    begin,
    refuse,
)
from slave.calibration.refusals import tendon_name
from slave.calibration.trend import Trend

WINDOW = 2e-4  # [m] of motor travel for the stiffness estimate
GAIN = 0.004  # [m/s] of winding per [N] of missing tension
LOOSE, TIGHT = 0.7, 1.3  # times the wanted tension: between them the motor rests
TIGHT_ENOUGH = 3.0  # times the take-up tension; friction near the motor allows nothing finer
SLACK_SPEED = 0.25  # of the seek speed: winding speed of a slack tendon
STEADY_S = 0.05  # [s] for which tensions must stay in their range before the next phase
TAUT = 0.2  # of the wanted tension; below it a tendon counts as slack
LEAST_RISE = 0.25  # of the target tension: least rise after contact with the stop
LEFT_STOP = 20.0  # times the compliance of the pull: the joint has left its stop
LOST = 0.3  # of the highest tension of a pull; below it the tendon has slipped or broken
RETRY = 5e-4  # [m] of travel before a working load cell is tested again
PROBE = 1e-5  # [m] to go back for the test
PROBE_S = 0.2  # [s] in which the cell must respond
OVER = 1.5  # times the expected travel of a pull or release
RUN_ON = 5e-4  # [m] added to that
BEYOND = 0.4  # of the range beyond the middle: end of the first of two drags
LEAD = 0.15  # of a drag, until both tendons slide
PEAK = 0.9  # of the target tension: where the tension of a drag turns
STRETCH = 1.5  # times the stretch of the pulled tendon at the peak: about that of both together
MOST_SHARE = 0.8  # of the speed: largest difference between paying out and drawing

Step = tuple[Tendons, ProcedureState]


def _take_up(
    config: InitialiseConfig, joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Wind in every tendon until it is just taut."""
    count = len(seen.tension)
    if memory.steady >= STEADY_S:
        if memory.phase is Phase.SETTLE:
            return _still(seen), begin(memory, Phase.DONE, seen)
        if not memory.home:
            memory = memory._replace(home=seen.travel)
        if memory.side == count:
            memory = memory._replace(lane=_lane(config, memory, seen))
        return _still(seen), begin(memory, _after_take_up(memory, count), seen)
    wound = [q - q0 for q, q0 in zip(seen.travel, memory.origin, strict=True)]
    allowed = config.slack_max + (config.pay_out + WINDOW if memory.stops else 0.0)
    if sum(wound) > allowed:
        loosest = min(range(count), key=lambda k: memory.tension[k])
        name = tendon_name(joint.number, count, loosest)
        if memory.tension[loosest] > TAUT * config.take_up or sum(wound) > 2.0 * allowed:
            return _slack(config, memory, seen, name, loosest, sum(wound), config.take_up)
    tightest = min(range(count), key=wound.__getitem__)
    if wound[tightest] < -allowed:
        name = tendon_name(joint.number, count, tightest)
        why = refusals.tight(name, -wound[tightest], memory.tension[tightest])
        return _refused(memory, seen, why)
    return tuple(
        _held(config, memory.tension[k], config.take_up, TIGHT_ENOUGH, 0.0) for k in range(count)
    ), memory


def _after_take_up(memory: ProcedureState, count: int) -> Phase:
    return Phase.SEEK if memory.side < count else Phase.DRAG


def _seek(
    config: InitialiseConfig, joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Pull one tendon until the joint is at its stop and the tension is reached."""
    k, count = memory.side, len(seen.tension)
    name = tendon_name(joint.number, count, k)
    tension, travel = memory.tension[k], seen.travel[k]
    line = _line(memory, seen, k, 1.0)
    stretching = trend.stiffness(line, WINDOW) * joint.compliance[k] >= 1.0
    contact = memory.contact
    if contact is None or not stretching:
        contact = Contact(travel, tension)
    memory = memory._replace(trend=line, contact=contact)
    if tension >= config.tension:
        return _found(config, joint.compliance[k], name, memory, seen)
    gone = travel - memory.origin[k]
    if gone > config.travel_max:
        unchanged = travel - memory.cells[k].since > 0.5 * gone
        return _refused(memory, seen, refusals.no_stop(name, tension, unchanged, config))
    if tension < LOST * memory.highest and memory.highest > LEAST_RISE * config.tension:
        return _refused(memory, seen, refusals.lost(name, memory.highest, tension))
    if travel > memory.tried + RETRY and cell.is_stuck(memory.cells[k], travel):
        return _still(seen), begin(memory, Phase.PROBE, seen)
    speed = config.stretch_speed if stretching else config.seek_speed
    return _drawn(config, joint, memory, seen, k, speed)


def _found(
    config: InitialiseConfig, softest: float, name: str, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Accept the end of the search as a stop, unless it is implausible."""
    k, contact = memory.side, memory.contact
    assert contact is not None  # noqa: S101 - set by the caller
    rise = memory.tension[k] - contact.tension
    if rise < LEAST_RISE * config.tension:
        why = refusals.late_stop(name, contact.tension, memory.tension[k])
        return _refused(memory, seen, why)
    compliance = (seen.travel[k] - contact.travel) / rise
    if compliance > softest:
        why = refusals.soft_stop(name, contact.tension, compliance, softest)
        return _refused(memory, seen, why)
    stops = (*memory.stops, contact._replace(compliance=compliance))
    after = Phase.SLACKEN if len(seen.tension) > 1 else Phase.RELEASE
    return _still(seen), begin(memory._replace(stops=stops, releases=0), after, seen)


def _probe(
    config: InitialiseConfig, joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Go back a little to test whether the load cell responds."""
    k = memory.side
    if memory.cells[k].alike == 0:
        memory = memory._replace(tried=seen.travel[k])
        return _still(seen), begin(memory, Phase.SEEK, seen)
    if memory.elapsed > PROBE_S:
        name = tendon_name(joint.number, len(seen.tension), k)
        return _refused(memory, seen, refusals.saturated(name, memory.tension[k]))
    back = seen.motor[k] > memory.origin[k] - PROBE
    return _only(seen, k, -config.stretch_speed if back else 0.0), memory


def _slacken(
    config: InitialiseConfig, _joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Pay out the other tendon until it cannot pull the joint off its stop."""
    other = 1 - memory.side
    if memory.origin[other] - seen.travel[other] >= config.pay_out:
        return _still(seen), begin(memory, Phase.RELEASE, seen)
    return _only(seen, other, -config.seek_speed), memory


def _release(
    config: InitialiseConfig, _joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Release one tendon until its tension is low or the joint leaves the stop."""
    k = memory.side
    line = _line(memory, seen, k, -1.0)
    memory = memory._replace(trend=line)
    left = trend.stiffness(line, WINDOW) * memory.stops[k].compliance * LEFT_STOP < 1.0
    enough = _expected(config, memory)
    gone = memory.origin[k] - seen.travel[k]
    if not (memory.tension[k] <= config.low or left or gone > enough):
        return _only(seen, k, -_stretch_speed(config, memory)), memory
    memory = memory._replace(releases=memory.releases + 1)
    if memory.releases <= config.loops:
        return _still(seen), begin(memory, Phase.PULL, seen)
    memory = memory._replace(side=memory.side + 1, contact=None, tried=-math.inf)
    if len(seen.tension) == 1:
        return _still(seen), begin(memory, Phase.RETURN, seen)
    return _still(seen), begin(memory, Phase.TAKE_UP, seen)


def _pull(
    config: InitialiseConfig, joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Pull one tendon against the stop again."""
    k = memory.side
    tension, gone = memory.tension[k], seen.travel[k] - memory.origin[k]
    if tension >= config.tension:
        return _still(seen), begin(memory, Phase.RELEASE, seen)
    name = tendon_name(joint.number, len(seen.tension), k)
    if cell.is_stuck(memory.cells[k], seen.travel[k]):
        return _refused(memory, seen, refusals.saturated(name, tension))
    if tension < LOST * memory.highest and memory.highest > LEAST_RISE * config.tension:
        return _refused(memory, seen, refusals.lost(name, memory.highest, tension))
    if gone > _expected(config, memory):
        if tension < TAUT * config.take_up:
            return _refused(memory, seen, refusals.lost(name, config.tension, tension))
        return _refused(memory, seen, refusals.pull_not_repeated(name, tension, config))
    return _only(seen, k, _stretch_speed(config, memory)), memory


def _drag(
    config: InitialiseConfig, joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Pull one tendon at one speed while the tension of the other one rises, and falls again.

    The other tendon is paid out more slowly than it is drawn, then faster: both keep sliding in one
    direction, and the joint's own resistance is the same with rising and falling tension.
    """
    k = memory.side % 2
    tension, gone = memory.tension[k], seen.travel[k] - memory.origin[k]
    if tension >= config.tension:
        return _refused(memory, seen, refusals.in_the_way(joint.number, tension))
    if gone >= memory.lane:
        if memory.side + 1 < 2 + config.drags:
            lane = memory.lane * BEYOND / (0.5 + BEYOND)
            memory = memory._replace(side=memory.side + 1, lane=lane, easing=False)
            return _still(seen), begin(memory, Phase.DRAG, seen)
        return _still(seen), begin(memory, Phase.SETTLE, seen)
    speed = min(config.seek_speed, memory.lane / config.drag_time)
    if gone < LEAD * memory.lane or (memory.easing and memory.tension[1 - k] <= config.keep):
        return _drawn(config, joint, memory, seen, k, speed)
    peak = PEAK * config.tension
    if tension >= peak or gone > (0.5 + 0.5 * LEAD) * memory.lane:
        memory = memory._replace(easing=True)
    stretch = STRETCH * memory.stops[k].compliance * peak
    share = min(stretch / (0.5 * (1.0 - LEAD) * memory.lane), MOST_SHARE)
    drawn = speed * (1.0 + share if memory.easing else 1.0 - share)
    return ((speed, -drawn) if k == 0 else (-drawn, speed)), memory


def _lane(config: InitialiseConfig, memory: ProcedureState, seen: JointReadings) -> float:
    """Return the length [m] of the first drag: to the middle, or such that the next ends there."""
    reach = memory.stops[0].travel - seen.travel[0]
    return reach * (0.5 + (BEYOND if config.drags > 1 else 0.0))


def _return(
    config: InitialiseConfig, _joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Let a return spring take the joint back to where it came from."""
    if seen.travel[0] <= memory.home[0]:
        return _still(seen), begin(memory, Phase.SETTLE, seen)
    return _only(seen, 0, -config.seek_speed), memory


def _relax(
    config: InitialiseConfig, joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    """Lower all tensions slowly; wind in nothing and pay out no more than needed."""
    if memory.steady >= STEADY_S or memory.elapsed > config.relax_max:
        return _still(seen), begin(memory, Phase.REFUSED, seen)
    speeds = []
    for k, tension in enumerate(memory.tension):
        most = OVER * joint.compliance[k] * config.tension + RUN_ON
        tight = tension > relaxed_tension(config) and memory.origin[k] - seen.motor[k] < most
        speeds.append(-0.5 * config.seek_speed if tight else 0.0)
    return tuple(speeds), memory


def _rest(
    _config: InitialiseConfig, _joint: Joint, memory: ProcedureState, seen: JointReadings
) -> Step:
    return _still(seen), memory


def _refused(memory: ProcedureState, seen: JointReadings, why: str) -> Step:
    return _still(seen), refuse(memory, seen, why)


def _slack(
    config: InitialiseConfig,
    memory: ProcedureState,
    seen: JointReadings,
    name: str,
    k: int,
    wound: float,
    wanted: float,
) -> Step:
    why = refusals.slack(name, wound, memory.tension[k], TAUT * wanted, config)
    return _refused(memory, seen, why)


def _still(seen: JointReadings) -> Tendons:
    return (0.0,) * len(seen.motor)


def _only(seen: JointReadings, tendon: int, speed: float) -> Tendons:
    return tuple(speed if k == tendon else 0.0 for k in range(len(seen.motor)))


def _line(memory: ProcedureState, seen: JointReadings, k: int, direction: float) -> Trend:
    if memory.trend is None:
        return trend.start(seen.travel[k], seen.tension[k])
    return trend.update(memory.trend, seen.travel[k], seen.tension[k], direction, WINDOW)


def _expected(config: InitialiseConfig, memory: ProcedureState) -> float:
    """Return the largest motor travel [m] of a whole pull or release."""
    return OVER * memory.stops[memory.side].compliance * config.tension + RUN_ON


def _stretch_speed(config: InitialiseConfig, memory: ProcedureState) -> float:
    """Return the speed [m/s] for a pull or release of duration `stretch_time`."""
    return memory.stops[memory.side].compliance * config.tension / config.stretch_time


def _held(
    config: InitialiseConfig, tension: float, wanted: float, tight: float, along: float
) -> float:
    """Return the speed [m/s] that keeps a tendon near `wanted` [N] while its end moves by `along`.

    No control between `LOOSE` and `tight` times that tension.
    """
    if tension < TAUT * wanted:
        return along + SLACK_SPEED * config.seek_speed
    alone = LOOSE * wanted <= tension <= tight * wanted
    speed = 0.0 if alone else GAIN * (wanted - tension)
    return min(max(along + speed, -2.0 * config.seek_speed), config.seek_speed)


def _drawn(
    config: InitialiseConfig,
    joint: Joint,
    memory: ProcedureState,
    seen: JointReadings,
    k: int,
    speed: float,
) -> Step:
    """Pull tendon `k` at `speed`; pay the other one out as fast and keep it just taut.

    As fast even while the joint rests: if it lagged, the joint would have to draw it out with e^K
    times its tension at the housing.
    """
    if len(seen.tension) == 1:
        return (speed,), memory
    other = 1 - k
    wound = seen.travel[other] - memory.lowest
    if wound > config.slack_max and memory.tension[other] < TAUT * config.keep:
        name = tendon_name(joint.number, 2, other)
        return _slack(config, memory, seen, name, other, wound, config.keep)
    kept = _held(config, memory.tension[other], config.keep, TIGHT, -speed)
    return ((speed, kept) if k == 0 else (kept, speed)), memory


def is_settled(config: InitialiseConfig, phase: Phase, tension: Tendons) -> bool:
    """Return whether all tendons have the target tension of this phase."""
    if phase is Phase.RELAX:
        return max(tension) <= relaxed_tension(config)
    if phase not in (Phase.TAKE_UP, Phase.SETTLE):
        return False
    least, most = 0.9 * LOOSE * config.take_up, 1.1 * TIGHT_ENOUGH * config.take_up
    return all(least <= t <= most for t in tension)


def relaxed_tension(config: InitialiseConfig) -> float:
    """Return the tension [N] to which tendons are released after an abort."""
    return 2.0 * max(config.low, config.take_up)


HANDLERS: dict[Phase, Callable[[InitialiseConfig, Joint, ProcedureState, JointReadings], Step]] = {
    Phase.TAKE_UP: _take_up,
    Phase.SEEK: _seek,
    Phase.PROBE: _probe,
    Phase.SLACKEN: _slacken,
    Phase.RELEASE: _release,
    Phase.PULL: _pull,
    Phase.DRAG: _drag,
    Phase.RETURN: _return,
    Phase.SETTLE: _take_up,
    Phase.DONE: _rest,
    Phase.RELAX: _relax,
    Phase.REFUSED: _rest,
}
