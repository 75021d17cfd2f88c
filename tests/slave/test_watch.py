"""The fault watch: each fault is found in time, by its name, and a healthy rig has none."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator import online
from estimator.sheath import Sheath
from slave.control import seen
from slave.plant.effects import BrokenTendon, JammedTendon, RepeatedSamples, Saturation, StuckCell
from slave.plant.environment import LoadMotorConfig, TissueConfig, WallConfig
from slave.rig import RigSample
from slave.watch import Finding, WatchConfig, start, step
from slave.watch.cell import Cell, watch_cell
from slave.watch.slack import TAUT, watch_slack
from slave.watch.winding import Winding, Wound, compliance, watch_winding
from teleop.session import Reason
from tests.slave.control_bench import DT, follow, joint, sine

CONFIG = WatchConfig()
BROKEN, JAMMED = Reason.TENDON_BROKEN, Reason.TENDON_JAMMED
SATURATED, STUCK = Reason.CELL_SATURATED, Reason.CELL_STUCK


# a load cell by itself


def readings(tension, noise, resolution, seed=0):
    """Return what a cell makes of tensions."""
    noisy = tension + noise * np.random.default_rng(seed).standard_normal(tension.shape)
    return np.round(noisy / resolution) * resolution if resolution else noisy


def judged(values, motor, noise, config=CONFIG):
    """Return the reasons found in a cell's readings [N] while the motor stands at `motor` [m]."""
    cell, reasons = Cell(), []
    for tension, place in zip(values.tolist(), motor.tolist(), strict=True):
        reason, cell = watch_cell(config, noise, cell, tension, place, DT)
        reasons.append(reason)
    return np.array(reasons)


def total(noise, resolution):
    return math.hypot(noise, resolution / 12**0.5)


N = 4000
AT_REST = np.zeros(N)
TO_AND_FRO = 5e-3 * np.sin(np.arange(N) * DT * 5.0)
RISING = 1.0 + np.arange(N) * 2e-3
CONSTANT = np.full(N, 3.0)
CONSTANT[0] = 2.0  # a cell that has ever shown something else


@pytest.mark.parametrize("tension", [CONSTANT, RISING])
@pytest.mark.parametrize(
    ("noise", "resolution"), [(0.01, 0.002), (0.03, 0.0), (0.002, 0.01), (0.0, 0.1), (0.0, 0.0)]
)
def test_a_cell_that_measures_is_never_stuck_moving_or_at_rest(noise, resolution, tension):
    values = readings(tension, noise, resolution)
    for motor in (AT_REST, TO_AND_FRO):
        assert not judged(values, motor, total(noise, resolution)).any()


def test_a_cell_slower_than_the_samples_repeats_itself_without_being_stuck():
    values = np.repeat(readings(RISING[::12], 0.01, 0.002), 12)[:N]
    assert not judged(values, TO_AND_FRO, 0.01).any()


def test_a_cell_less_noisy_than_it_is_said_to_be_is_not_stuck_once_it_has_rested():
    motor = np.concatenate([AT_REST[: N // 2], TO_AND_FRO[: N // 2]])
    values = np.concatenate([CONSTANT[: N // 2], CONSTANT[: N // 4] + 0.002, RISING[: N // 4]])
    assert not judged(values, motor, 0.01).any()


@pytest.mark.parametrize("at", [1000, 1300, 2100])
def test_a_stuck_cell_is_found_once_the_motor_moves(at):
    values = readings(3.0 + 0.1 * np.sin(np.arange(N) * 0.003), 0.01, 0.002)
    values[at:] = values[at]
    found = judged(values, TO_AND_FRO, total(0.01, 0.002))
    assert not found[: at + 90].any()
    assert (found[at + 110 :] == STUCK).all()
    assert not judged(values, AT_REST, total(0.01, 0.002)).any()


@pytest.mark.parametrize(("noise", "resolution"), [(0.01, 0.002), (0.03, 0.0), (0.01, 0.01)])
@pytest.mark.parametrize("at", [150, 1300])
def test_a_stuck_cell_is_found_too_where_the_model_has_no_noise(at, noise, resolution):
    values = readings(3.0 + 0.1 * np.sin(np.arange(N) * 0.003), noise, resolution)
    values[at:] = values[at]
    found = judged(values, TO_AND_FRO, 0.0)
    assert not found[: at + 90].any()
    assert np.isin(found[at + 110 :], [STUCK, SATURATED]).all()
    assert not judged(values, AT_REST, 0.0).any()


@pytest.mark.parametrize("resolution", [0.0, 0.002, 0.1])
def test_where_the_model_has_no_noise_a_load_that_changed_is_not_taken_for_noise(resolution):
    """Rising, swinging, hovering between two steps; then the same for as long while it moves."""
    hovering = 3.0 + 0.1 * np.random.default_rng(3).integers(2, size=N)
    for tension in (RISING, 3.0 + 2.0 * np.sin(np.arange(N) * 0.02), hovering):
        values = readings(np.append(tension, np.full(N, tension[-1])), 0.0, resolution)
        assert not judged(values, np.append(TO_AND_FRO, TO_AND_FRO), 0.0).any()


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_cell_that_has_shown_one_reading_only_is_stuck_once_a_taut_tendons_motor_has_gone_2_mm(
    noise,
):
    motor = np.arange(N) * 5e-6
    found = judged(np.full(N, 3.0), motor, noise)
    assert not found[motor < 2e-3].any()
    assert (found[motor > 2.01e-3] == STUCK).all()
    assert not judged(np.zeros(N), motor, noise).any()  # a slack tendon has no tension at all


def test_a_flat_top_while_the_motor_pulls_is_a_saturated_cell():
    values = np.minimum(readings(RISING, 0.01, 0.002), 5.0)
    motor = np.arange(N) * 5e-6
    found = judged(values, motor, total(0.01, 0.002))
    flat = int(np.argmax(RISING > 5.0))
    assert not found[:flat].any()
    assert (found[flat + 150 :] == SATURATED).all()


def test_a_cell_at_its_range_is_saturated_at_once():
    values = np.minimum(readings(RISING, 0.0, 0.0), 5.0)
    found = judged(values, AT_REST, 0.0, WatchConfig(cell_range=5.0))
    first = int(np.argmax(found == SATURATED))
    assert RISING[first] == pytest.approx(4.95 + 0.02, abs=0.01)
    assert (found[first:] == SATURATED).all()


# what two motors have wound in, by itself

SHEATH = Sheath.uniform(1.0, 1.5, 9000.0)
STRETCH = compliance(online.prepare(online.TendonModel(SHEATH)))


def wound(path):
    """Return what is found on a path of (T_a, T_b, q_a, q_b), and the last memory."""
    memory, found, slacks, before = Winding(), [], (TAUT, TAUT), (0.0, 0.0)
    for *tension, q_a, q_b in path:
        tendons = Wound(tension[0], q_a, 0.0), Wound(tension[1], q_b, 0.0)
        slacks = tuple(
            watch_slack(CONFIG, slack, now, was, q_a + q_b, DT)[1]
            for slack, now, was in zip(slacks, tension, before, strict=True)
        )
        before = tension
        reason, n, memory = watch_winding(CONFIG, memory, tendons, (STRETCH, STRETCH), slacks, DT)
        found.append(Finding(reason, n))
    return found, memory


def test_a_tendon_is_stretched_least_by_a_pull_and_most_by_a_release():
    """M_pull = L (1 - e^-K)/(EA K) and M_rel = M_pull e^K of an even bend, paper (12), (23)."""
    pull = 1.5 * (1.0 - math.exp(-1.0)) / 9000.0
    assert STRETCH.least(2.0) == pytest.approx(2.0 * pull)
    assert STRETCH.most(2.0) == pytest.approx(2.0 * pull * math.e)
    drag = online.TendonModel(Sheath.uniform(1.0, 1.5, 9000.0, drag=0.5))
    dragged = compliance(online.prepare(drag))
    assert dragged.least(2.0) == pytest.approx(2.5 * pull - 0.5 * 1.5 / 9000.0)


shares = st.floats(0.0, 1.0)
tensions = st.floats(0.0, 25.0)


@given(
    st.lists(st.tuples(tensions, tensions, shares, shares, st.floats(-0.02, 0.02)), max_size=60),
    st.floats(-0.01, 0.01),
    st.floats(0.97, 1.03),
)
def test_tendons_stretched_within_what_friction_allows_are_healthy(samples, constant, error):
    """Whatever the history, whoever drove: every sample may be anywhere in its interval."""
    path = []
    for T_a, T_b, share_a, share_b, travel in samples:
        e = [
            error * (STRETCH.least(T) + share * (STRETCH.most(T) - STRETCH.least(T)))
            for T, share in ((T_a, share_a), (T_b, share_b))
        ]
        path += [(T_a, T_b, travel + e[0] + constant, e[1] - travel)] * 12
    found, _ = wound(path)
    assert all(finding.reason is Reason.NONE for finding in found)


def test_where_both_are_slack_the_first_or_tighter_of_them_is_broken():
    drove = healthy(0.3, 5.0)[2:]
    before = [(0.3, 5.0, *drove)] * 20
    found, _ = wound(before + [(0.0, 0.0, *drove)] * 20)
    assert found[-1] == Finding(BROKEN, 1)
    found, _ = wound(before + [(0.0, 5.0, *drove)] + [(0.0, 0.0, *drove)] * 20)
    assert found[-1] == Finding(BROKEN, 0)


def test_a_tendon_that_is_taut_by_value_goes_slack_from_where_it_is():
    """Memory that was written out and read in is no longer the same object."""
    copied = type(TAUT)(*TAUT)
    for taut in (TAUT, copied):
        broken, after = watch_slack(CONFIG, taut, 0.0, 5.0, 0.012, DT)
        assert (broken, after.time, after.lost, after.wound) == (False, 0.0, 5.0, 0.012)


def healthy(T_a, T_b, travel=0.0):
    return T_a, T_b, travel + STRETCH.least(T_a), STRETCH.least(T_b) - travel


def test_a_slack_tendon_that_is_wound_in_is_broken_within_the_millimetre():
    path = [healthy(5.0, 0.3)] * 20
    T_a, T_b, q_a, q_b = healthy(0.0, 0.3)
    path += [(T_a, T_b, q_a + k * 5e-6, q_b) for k in range(200)]  # reeled in at 5 mm/s
    found, _ = wound(path)
    first = next(k for k, finding in enumerate(found) if finding.reason is not Reason.NONE)
    assert found[first] == Finding(BROKEN, 0)
    assert (first - 20) * 5e-6 < 1e-3
    # an antagonist that is stretched unseen explains as much as friction can hide, not more
    hidden = [healthy(5.0, 0.3)] * 20 + [(0.0, 0.3, q_a, q_b + STRETCH.most(0.3))] * 50
    assert wound(hidden)[0][-1].reason is Reason.NONE


def test_a_tension_that_gone_without_the_motor_is_a_broken_tendon():
    T_a, T_b, q_a, q_b = healthy(10.0, 0.3)
    found, _ = wound([(T_a, T_b, q_a, q_b)] * 20 + [(0.0, T_b, q_a, q_b)] * 15)
    assert found[-1] == Finding(BROKEN, 0)
    assert found[25].reason is Reason.NONE  # not by a single sample


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_a_tendon_stretched_over_a_part_of_its_sheath_is_jammed(share):
    part = Sheath.uniform(share * 1.0, share * 1.5, 9000.0)
    jammed = compliance(online.prepare(online.TendonModel(part)))
    path = [healthy(0.3, 0.3)] * 20
    path += [(0.3, T, 0.0, jammed.least(T)) for T in np.linspace(0.3, 20.0, 300)]
    found, _ = wound(path)
    assert found[-1] == Finding(JAMMED, 1)


def test_what_drifts_slowly_is_creep():
    T_a, T_b, q_a, q_b = healthy(0.3, 0.3)
    for drift in (-1e-5, 1e-5):  # [m/s] 0.6 mm in a minute
        path = [(T_a, T_b, q_a, q_b + drift * DT * k) for k in range(60_000)]
        found, _ = wound(path)
        assert found[-1].reason is Reason.NONE


def test_a_tendon_paid_out_until_it_is_slack_is_not_jammed():
    T_a, T_b, q_a, q_b = healthy(0.3, 0.3)
    path = [(T_a, T_b, q_a, q_b)] * 20
    path += [(T_a, 0.0, q_a, q_b - k * 5e-5) for k in range(100)]
    found, _ = wound(path)
    assert all(finding.reason is Reason.NONE for finding in found)


def test_pulleys_that_are_not_quite_alike_are_no_fault():
    path = [healthy(0.3, 0.3)] * 20
    for travel in np.linspace(0.0, 0.015, 300):
        T_a, T_b, q_a, q_b = healthy(2.0, 0.3)
        path.append((T_a, T_b, q_a + travel, q_b - 1.03 * travel))
    found, _ = wound(path)
    assert all(finding.reason is Reason.NONE for finding in found)


def test_a_load_cell_that_lags_is_no_fault_however_fast_the_motor():
    """Paid out at 50 mm/s with tensions 10 ms old: they are too high for 0.5 mm less of stretch."""
    speed, late = 0.05, 10
    stretch = np.maximum(STRETCH.least(20.0) - speed * DT * np.arange(41), STRETCH.least(0.3))
    tension = stretch / STRETCH.pull
    memory = Winding()
    for k in range(-20, 41):
        now, then = max(k, 0), max(k - late, 0)
        tendons = (
            Wound(tension[then], stretch[now], -speed if k > 0 else 0.0),
            Wound(0.3, STRETCH.least(0.3), 0.0),
        )
        if k == -20:  # it began loose
            first = Wound(0.3, STRETCH.least(0.3), 0.0)
            *_, memory = watch_winding(
                CONFIG, memory, (first, first), (STRETCH, STRETCH), (TAUT, TAUT), DT
            )
        reason, _, memory = watch_winding(
            CONFIG, memory, tendons, (STRETCH, STRETCH), (TAUT, TAUT), DT
        )
        assert reason is Reason.NONE


# samples of a rig


def test_a_sample_that_the_estimator_refused_tells_nothing_and_an_encoder_may_be_missing():
    prepared = [online.prepare(online.TendonModel(SHEATH))] * 2
    joints = ((0, 1),)
    memory = start(joints, prepared)
    states = [online.initial(p) for p in prepared]
    for k in range(300):
        tension = np.array([math.nan if k % 3 == 0 else 5.0 + 0.01 * k, 0.3])
        travel = None if k % 5 == 0 else np.array([1e-4 * k, -1e-4 * k])
        sample = RigSample(k * DT, tension, travel)
        pairs = zip(tension, [0.0, 0.0] if travel is None else travel, strict=True)
        estimates = [
            online.step(p, s, T, q, DT)[0]
            for p, s, (T, q) in zip(prepared, states, pairs, strict=True)
        ]
        finding, memory = step(CONFIG, joints, memory, seen(sample, estimates), DT)
        assert finding is None
    assert all(math.isfinite(wound.tension) for wound in memory.wounds)


def test_a_stuck_cell_is_not_taken_for_a_jam_by_what_it_reads():
    """The motor pays out while the reading stays: as if the tendon were tight without stretch."""
    prepared = [online.prepare(online.TendonModel(SHEATH, tension_noise=0.01))] * 2
    joints, state = ((0, 1),), online.initial(prepared[0])
    memory, found = start(joints, prepared), []
    T_a, T_b, q_a, q_b = healthy(10.0, 0.3)
    noise = readings(np.zeros((600, 2)), 0.01, 0.002)
    for k in range(600):
        moved = 2e-5 * max(k - 300, 0)
        read = T_a + (noise[k, 0] if k < 300 else 0.0), T_b + noise[k, 1]
        if k == 0:
            read = 0.3, T_b  # it began loose
        sample = RigSample(k * DT, np.array(read), np.array([q_a - moved if k else q_b, q_b]))
        estimates = [online.step(prepared[0], state, T, 0.0, DT)[0] for T in read]
        finding, memory = step(CONFIG, joints, memory, seen(sample, estimates), DT)
        if finding is not None:
            found.append(finding)
    assert found[0] == Finding(STUCK, 0)


# joints on the simulated rig

LOADED = joint(0.8, spring=300.0)
SWING = sine(0.006, 0.5)


def first_found(effect, joints=(LOADED,), seconds=4.0, command=SWING):
    """Return how long after its start a fault is found [s], and what is."""
    record = follow(joints, [command] * len(joints), seconds, effects=[effect], until_found=True)
    assert record.found
    time, finding = record.found[0]
    return time - effect.start, finding


@pytest.mark.parametrize("start_at", [0.5, 1.5])  # as it drives, and as it is loose
@pytest.mark.parametrize("share", [0.05, 0.95])
def test_a_broken_tendon_is_found_in_a_fifth_of_a_second(share, start_at):
    effect = BrokenTendon(start=start_at, tendon="a", share=share)
    after, finding = first_found(effect)
    assert finding == Finding(BROKEN, 0)
    assert after < 0.2


def test_the_tendon_that_broke_is_named_among_those_of_all_joints():
    effect = BrokenTendon(start=0.5, joint=2, tendon="b", share=0.5)
    _, finding = first_found(effect, (LOADED, LOADED))
    assert finding == Finding(BROKEN, 3)


def test_a_broken_tendon_of_a_joint_that_has_but_one_is_found_once_it_is_reeled_in():
    alone = joint(0.4, spring=300.0, tendons=1, pretension=2.0)
    effect = BrokenTendon(start=0.5, tendon="a")
    after, finding = first_found(effect, (alone,), 6.0, lambda _: (0.002, 0.0))
    assert finding == Finding(BROKEN, 0)
    assert after < 5.0


@pytest.mark.parametrize(("share", "within"), [(0.0, 0.1), (0.25, 0.2), (0.5, 0.3)])
def test_a_jammed_tendon_is_found_as_soon_as_it_is_pulled(share, within):
    after, finding = first_found(JammedTendon(start=2.15, tendon="a", share=share))
    assert finding == Finding(JAMMED, 0)
    assert after < within


@pytest.mark.parametrize("tendon", ["a", "b"])
def test_a_stuck_cell_is_found_in_an_eighth_of_a_second(tendon):
    after, finding = first_found(StuckCell(start=1.85, tendon=tendon))
    assert finding == Finding(STUCK, "ab".index(tendon))
    assert after < 0.125


def test_a_saturated_cell_is_found_while_the_motor_pulls():
    record = follow([LOADED], [SWING], 2.0, until_found=True)
    assert record.tension[:, 0].max() > 3.0
    after, finding = first_found(Saturation(tendon="a", limit=2.0))
    assert finding == Finding(SATURATED, 0)
    assert after < 0.5


def wanderings(rng, extent, seconds):
    """Return a random profile of a load motor."""
    times = np.cumsum(rng.choice([0.05, 0.2, 0.5], 200))
    times = times[times < seconds].tolist()
    return tuple((time, float(rng.uniform(-extent, extent))) for time in times)


def random_command(rng, extent, seconds):
    """Return reaches between random places, some fast, some after a rest."""
    times, places = [0.0], [0.0]
    while times[-1] < seconds:
        place = rng.uniform(-extent, extent)
        times.append(times[-1] + max(abs(place - places[-1]) / rng.uniform(0.003, 0.03), 0.05))
        places.append(place)
        times.append(times[-1] + rng.choice([1e-3, 0.1, 0.4]))
        places.append(place)

    def at(time):
        k = int(np.searchsorted(times, time, side="right")) - 1
        span, way = times[k + 1] - times[k], places[k + 1] - places[k]
        u = (time - times[k]) / span
        return places[k] + way * u * u * (3.0 - 2.0 * u), way * 6.0 * u * (1.0 - u) / span

    return at


HEALTHY = ("free", "wall", "tissue", "pushed", "dragged", "stops", "coarse", "noiseless", "repeats")


@pytest.mark.parametrize("what", HEALTHY)
def test_a_healthy_joint_raises_no_alarm(what):
    rng, seconds = np.random.default_rng(HEALTHY.index(what)), 4.0
    K = rng.uniform(0.4, 1.8)
    settings = {
        "noise": rng.uniform(0.01, 0.03),
        "spring": 600.0 * math.exp(-K) * rng.integers(2),
        "friction": 0.1 * rng.integers(3),
    } | {
        "wall": {"environment": WallConfig(position=0.002, stiffness=5e4)},
        "tissue": {"environment": TissueConfig(position=0.001)},
        "pushed": {"environment": LoadMotorConfig(profile=wanderings(rng, 1.5, seconds))},
        "dragged": {
            "environment": LoadMotorConfig(
                mode="position", profile=wanderings(rng, 0.004, seconds), stiffness=1000.0
            )
        },
        "stops": {"stops": (-0.003, 0.004)},
        "coarse": {"resolution": 0.1, "noise": 0.0},
        "noiseless": {"resolution": 0.0, "noise": 0.0},
    }.get(what, {})
    effects = [RepeatedSamples(share=0.3, burst=20.0)] if what == "repeats" else []
    errors = rng.uniform(0.98, 1.02), rng.uniform(0.97, 1.03)
    command = random_command(rng, 0.006, seconds)
    record = follow(
        [joint(K, **settings)], [command], seconds, errors=errors, effects=effects, seed=7
    )
    assert record.found == ()


def test_settings_that_cannot_be_are_refused():
    for wrong in (
        {"slack": -0.1},
        {"take_up": 0.0},
        {"misfit": math.nan},
        {"misfit_share": 1.0},
        {"cell_range": 0.0},
        {"stuck_time": 0.0},
        {"stuck_travel": math.inf},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            dataclasses.replace(CONFIG, **wrong)
