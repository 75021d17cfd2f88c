"""Samples of a rig against all that counts as a fault, and the settings."""

import math

import numpy as np

from estimator.law.sheath import Sheath
from estimator.online import online
from estimator.structs import to_struct, view_struct
from slave import fault_detection
from slave.fault_detection import FaultDetectionConfig
from slave.fault_detection.wound_length import compute_compliance, compute_elongation_min
from slave.rig import RigSample
from slave.rig_layout import EstimatedTendon, build_rig_layout
from studies.testbed.control_bench import DT, to_tendon_records
from teleop.session.state_machine import Reason
from tests.slave.fault_detection.readings import readings

CONFIG = FaultDetectionConfig()
SHEATH = Sheath.uniform(1.0, 1.5, 9000.0)
HEALTHY = Reason.NONE, -1


class Detector:
    """A detector of a rig whose tendons have one model."""

    def __init__(self, joints, model):
        self.joints, self.layout = joints, view_struct(build_rig_layout(joints))
        tendons = sum(map(len, joints))
        self.record = view_struct(fault_detection.init_detector([model] * tendons))
        self.limits = to_struct(CONFIG)

    def step(self, tendons):
        return fault_detection.step(self.limits, self.layout, self.record, tendons, DT)


def test_a_sample_that_the_estimator_refused_tells_nothing_and_an_encoder_may_be_missing():
    prepared = [online.prepare(online.TendonModel(SHEATH))] * 2
    detector = Detector(((0, 1),), online.TendonModel(SHEATH))
    states = [online.build_initial_state(p) for p in prepared]
    for k in range(300):
        tension = np.array([math.nan if k % 3 == 0 else 5.0 + 0.01 * k, 0.3])
        travel = None if k % 5 == 0 else np.array([1e-4 * k, -1e-4 * k])
        sample = RigSample(k * DT, tension, travel)
        pairs = zip(tension, [0.0, 0.0] if travel is None else travel, strict=True)
        estimates = [
            online.step(p, s, T, q, DT)[0]
            for p, s, (T, q) in zip(prepared, states, pairs, strict=True)
        ]
        assert detector.step(to_tendon_records(sample, estimates)) == HEALTHY
    assert all(math.isfinite(t.average.tension) for t in detector.record.tendon[:2])


def test_a_stuck_cell_is_not_taken_for_a_jam_by_what_it_reads():
    """The motor pays out while the reading stays: as if the tendon were tight without stretch."""
    model = online.TendonModel(SHEATH, tension_noise=0.01)
    prepared = online.prepare(model)
    state, stretch = online.build_initial_state(prepared), compute_compliance(SHEATH)
    detector, found = Detector(((0, 1),), model), []
    T_a, T_b = 10.0, 0.3
    q_a, q_b = compute_elongation_min(stretch, T_a), compute_elongation_min(stretch, T_b)
    noise = readings(np.zeros((600, 2)), 0.01, 0.002)
    for k in range(600):
        moved = 2e-5 * max(k - 300, 0)
        read = T_a + (noise[k, 0] if k < 300 else 0.0), T_b + noise[k, 1]
        if k == 0:
            read = 0.3, T_b  # it began loose
        sample = RigSample(k * DT, np.array(read), np.array([q_a - moved if k else q_b, q_b]))
        estimates = [online.step(prepared, state, T, 0.0, DT)[0] for T in read]
        fault = detector.step(to_tendon_records(sample, estimates))
        if fault != HEALTHY:
            found.append(fault)
    assert found[0] == (Reason.CELL_STUCK, 0)


def measured(tension, displacement):
    """Return tendons that the estimator took, the same displacement for each."""
    tendons = EstimatedTendon.array(16)
    tendons["tension"][: len(tension)] = tension
    tendons["displacement"][: len(tension)] = displacement
    tendons["valid"][: len(tension)] = True
    return tendons


def test_what_one_joint_goes_through_changes_nothing_of_another():
    """The second joint of two gets the same samples, whether the first is healthy or breaks."""
    left = []
    for breaks in (False, True):
        detector = Detector(((3, 0), (1,), (2, 4)), online.TendonModel(SHEATH, tension_noise=0.01))
        noise = readings(np.zeros((300, 5)), 0.01, 0.002)
        found = set()
        for k in range(300):
            tension = 3.0 + noise[k]
            if breaks and k > 100:
                tension[[3, 0]] = 0.0
            found.add(detector.step(measured(tension, 1e-6 * k)))
        assert (found == {HEALTHY}) != breaks
        tendons = [detector.record.tendon[i] for i in (1, 2, 4)]
        left.append([record.tobytes() for record in (*tendons, *detector.record.winding[1:3])])
        assert (
            detector.record.tendon[5:].tobytes()
            == fault_detection.init_detector([])["tendon"][0, 5:].tobytes()
        )
    assert left[0] == left[1]


def test_a_broken_tendon_is_named_by_its_number_in_the_rig():
    detector, found = Detector(((3, 0), (1,), (2, 4)), online.TendonModel(SHEATH)), []
    for k in range(200):
        tension = np.array([0.3, 3.0, 0.3, 3.0, 10.0]) + 1e-3 * k
        tension[4] *= k < 100
        found.append(detector.step(measured(tension, 1e-6 * k)))
    assert set(found[:100]) == {HEALTHY}
    assert found[-1] == (Reason.TENDON_BROKEN, 4)
