"""Numbers of the tendons of a rig's joints."""


def number_joint_tendons(counts: list[int]) -> tuple[tuple[int, ...], ...]:
    """Return which tendons each joint has: numbered from 0, joint after joint."""
    joints, first = [], 0
    for count in counts:
        joints.append(tuple(range(first, first + count)))
        first += count
    return tuple(joints)
