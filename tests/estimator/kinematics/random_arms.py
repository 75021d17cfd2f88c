"""Random arms, and the same as URDF."""

import math
from dataclasses import replace

import numpy as np

from estimator.kinematics.arm import Arm, CurvedSection, Joint, Offset

KINDS = ("revolute", "continuous", "prismatic", "fixed")


def random_offset(rng, size=0.1):
    return Offset(tuple(rng.normal(0.0, size, 3)), tuple(rng.uniform(-3.0, 3.0, 3)))


def random_joint(rng, name, kind, reach=2.0, speed=1.0):
    limits = {"lower": -reach, "upper": reach} if kind in ("revolute", "prismatic") else {}
    if kind == "prismatic":
        limits = {"lower": -0.05 * reach, "upper": 0.05 * reach}
    axis = tuple(rng.normal(size=3))
    return Joint(name, kind, axis, random_offset(rng), **limits, speed=speed, effort=2.0)


def random_chain(rng, count, kinds=KINDS, **options):
    """Return an arm of joints, of so many coordinates."""
    parts = []
    moving = 0
    while moving < count:
        kind = kinds[rng.integers(len(kinds))] if len(parts) < 20 else "revolute"
        parts.append(random_joint(rng, f"j{len(parts)}", kind, **options))
        moving += kind != "fixed"
    return Arm(tuple(parts))


def add_links(rng, arm):
    """Return the arm with a link of random mass and inertia behind each part."""
    parts = []
    for part in arm.parts:
        spread = rng.normal(0.0, 0.05, (3, 3))
        inertia = tuple((spread @ spread.T)[np.triu_indices(3)].tolist())
        centre = tuple(rng.normal(0.0, 0.1, 3).tolist())
        parts.append(replace(part, mass=rng.uniform(0.1, 2.0), centre=centre, inertia=inertia))
    return replace(arm, parts=tuple(parts))


def random_mixed_arm(rng):
    """Return an arm of joints and curved sections, with and without elongation."""
    first = CurvedSection("bend", 0.12, 3.0, random_offset(rng), elongation=(-0.03, 0.03))
    wrist = random_joint(rng, "wrist", "revolute")
    second = CurvedSection("end", 0.05, 3.0, random_offset(rng, 0.02))
    return Arm((first, wrist, second, random_joint(rng, "roll", "prismatic")), random_offset(rng))


def random_coordinates(rng, arm):
    low, high = np.array([(max(c.lower, -9.0), min(c.upper, 9.0)) for c in arm.coordinates]).T
    return rng.uniform(low, high)


def write_urdf(arm):
    """Return the URDF of a chain of joints from link `base` to link `tip`, with a branch beside."""
    links = ["base", *(f"after_{part.name}" for part in arm.parts[:-1]), "tip"]
    lines = ['<?xml version="1.0" encoding="utf-8"?>', '<robot name="random">']
    lines += [f'<link name="{name}"/>' for name in ("base", "beside")]
    lines.append(
        '<joint name="branch" type="floating"><parent link="base"/><child link="beside"/></joint>'
    )
    for part, parent, child in zip(arm.parts, links, links[1:], strict=False):
        position, rpy, axis = (
            " ".join(map(repr, map(float, numbers)))
            for numbers in (part.offset.position, part.offset.rpy, part.axis)
        )
        lines += [
            f'<joint name="{part.name}" type="{part.kind}">',
            f'<origin xyz="{position}" rpy="{rpy}"/><axis xyz="{axis}"/>',
            f'<parent link="{parent}"/><child link="{child}"/>',
        ]
        if part.kind != "fixed":
            ends = "" if math.isinf(part.upper) else f'lower="{part.lower}" upper="{part.upper}"'
            lines.append(f'<limit {ends} velocity="{part.speed}" effort="{part.effort}"/>')
        lines += ["</joint>", f'<link name="{child}">{write_inertial(part)}</link>']
    return "\n".join([*lines, "</robot>"])


def write_inertial(part):
    """Return the inertial of the link behind a joint, in turned axes; none without mass."""
    if part.mass == 0.0:
        return ""
    offset = Offset(part.centre, (0.3, -0.5, 0.7))
    turn = offset.to_matrix()[:3, :3]
    tensor = (turn.T @ part.to_inertia_matrix() @ turn)[np.triu_indices(3)].tolist()
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = " ".join(f'{n}="{value!r}"' for n, value in zip(names, tensor, strict=True))
    xyz, rpy = (" ".join(map(repr, numbers)) for numbers in (offset.position, offset.rpy))
    return (
        f'<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{part.mass!r}"/>'
        f"<inertia {inertia}/></inertial>"
    )
