"""An arm in the hand: the force at the joints arrives with the same power, also at a limit.

    python examples/arm_kinematics.py

A curved section with a wrist is moved sideways until its bend is at the limit. There the wrist
takes over, and the hand feels the wrist's torque alone.
"""

import numpy as np

import estimator as est

arm = est.Arm(
    (
        est.CurvedSection("bend", length=0.08, bend_max=0.6),
        est.Joint("wrist", axis=(0, 1, 0), lower=-1.2, upper=1.2),
    ),
    tip=est.Offset((0.0, 0.0, 0.03)),
)
prepared = est.prepare_arm(arm)[0]
position = est.InverseConfig(weights=(1, 1, 0, 0, 0, 0))  # of the tip, across the arm
settings = est.build_inverse_settings(position)[0]
step = est.InverseStep.array()[0]

q, dt = np.zeros(3), 1e-3  # bend towards x and y, wrist
torque = np.array([0.05, 0.0, 0.02])  # [N m]
twist, error = np.array([0.02, 0, 0, 0, 0, 0]), np.zeros(6)  # [m/s], [rad/s]
hand_work = joint_work = 0.0
for tick in range(2501):
    jacobian = est.compute_jacobian(prepared, q)
    est.step_inverse(prepared, settings, jacobian, q, twist, error, dt, step)
    force = step["velocity_map"][:3].T @ torque
    velocity = step["joint_velocity"][:3]
    hand_work += force @ twist * dt
    joint_work += torque @ velocity * dt
    q = q + velocity * dt
    if tick % 500 == 0:
        x = est.compute_tip_pose(prepared, q)[0, 3]
        print(f"{1e3 * x:5.1f} mm: bend {q[0]:.2f}, wrist {q[2]:.2f} rad, hand {force[0]:.2f} N")
print(f"work of the hand {1e3 * hand_work:.4f} mJ, of the joints {1e3 * joint_work:.4f} mJ")
