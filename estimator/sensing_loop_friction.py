"""Friction over a tube, from a sensing loop: a tendon to the tip and back beside those that work.

One end is moved to and fro, the other held by a spring; both have a load cell at the housing. The
tension T_2 at the held end changes only while all of the loop slides (T10). Then

    ln(T_1 / T_2) = phi as T_2 rises, -phi as T_2 falls,

phi being the friction there and back (T2), wherever it sits. The sum of both is that of the cells'
gains. K of a tendon in the same tube is proportional to phi.
"""

import math
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.noise_treatment import update_average, update_play
from estimator.structs import F64, Field, Struct

AVERAGE_S = 0.01  # [s] of both tensions
BAND = 0.1  # [N] of T_2: less is noise
CHANGE_MIN, CHANGE_SHARE = 0.3, 0.05  # [N] and of T_2: its change in one direction for a reading
STEADY = 0.02  # change of the log ratio meanwhile: more, and a cell is stuck or friction changes
LEAST_TENSION = 0.1  # [N]
AGE_MAX_S = 5.0  # [s] of the last reading, that tell the gains of the cells
GAIN_SHARE = 0.1  # of a new value in the gain: a change of phi between two readings shows in it


class SensingLoopState(Struct):
    """A sensing loop between two samples."""

    tension: Annotated[Array, Field("f8", 2, fill=math.nan)]  # [N] averaged
    held: F64 = math.nan  # [N] T_2 behind its dead band
    direction: F64 = 0.0  # of its last change
    change: F64 = 0.0  # [N] of it, since the last turn or log ratio
    area: F64 = 0.0  # [N] integral of the log ratio over it
    newest: F64 = math.nan  # log ratio before that, in this direction
    ratio: F64 = math.nan  # log ratio of the last reading
    read_direction: F64 = 0.0  # of that
    gain: F64 = math.nan  # ln of the gain of one cell over that of the other
    age: F64 = AGE_MAX_S  # [s] of the last reading


@jit_compile
def measure_loop_friction(state: SensingLoopState, moved: float, held: float, dt: float) -> float:
    """Return phi if this sample completes a reading, else NaN; change `state` in place.

    `moved` and `held` [N] are the tensions at the two ends, `dt` [s] the time since the last ones.
    """
    state.age += dt
    if not (LEAST_TENSION < moved < math.inf and LEAST_TENSION < held < math.inf):  # nor NaN
        return math.nan
    if math.isnan(state.held):
        state.tension[0], state.tension[1], state.held = moved, held, held
    state.tension[0] = update_average(state.tension[0], moved, dt, AVERAGE_S)
    state.tension[1] = update_average(state.tension[1], held, dt, AVERAGE_S)
    change = update_play(state.held, state.tension[1], BAND) - state.held
    if change == 0.0:
        return math.nan
    state.held += change
    direction = math.copysign(1.0, change)
    if direction != state.direction:
        state.direction, state.change, state.area, state.newest = direction, 0.0, 0.0, math.nan
    state.change += abs(change)
    state.area += abs(change) * math.log(state.tension[0] / state.tension[1])
    if state.change < max(CHANGE_MIN, CHANGE_SHARE * state.held):
        return math.nan
    before, ratio = state.newest, state.area / state.change
    state.newest, state.change, state.area = ratio, 0.0, 0.0
    if not abs(ratio - before) < STEADY:
        return math.nan
    if direction == -state.read_direction and state.age < AGE_MAX_S:
        gain = 0.5 * (ratio + state.ratio)
        known = gain if math.isnan(state.gain) else state.gain
        state.gain = known + GAIN_SHARE * (gain - known)
    state.ratio, state.read_direction, state.age = ratio, direction, 0.0
    return direction * (ratio - state.gain)
