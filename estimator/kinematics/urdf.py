"""An arm from URDF, the description of robots in XML (https://wiki.ros.org/urdf/XML)."""

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np

from estimator.kinematics.arm import Arm, ArmError, Joint, Offset

URDF_BYTES_MAX = 5_000_000
"""Largest description that is read; descriptions of arms have some 100 kB."""

_JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")
_INSTALL = "pip install 'tendon-teleop[urdf]'"


def read_arm(urdf: bytes, *, tip: str, base: str | None = None, source: str = "URDF") -> Arm:
    """Return the chain of joints between two links of a URDF description.

    Joints beside the chain are left out. Limits of position, speed and effort are kept; a
    continuous joint may have none.

    Parameters
    ----------
    urdf : bytes
        The XML, as in the file.
    tip : str
        The link that is the tip.
    base : str, optional
        The link that is the base; the root of the description if None.
    source : str
        What the description is called in messages, such as the path of its file.

    Raises
    ------
    ArmError
        It is no URDF, a link is unknown, the tip is not beyond the base; or a joint of the chain
        mimics another one, is floating or planar, or has no limits; or there are too many.
    """
    robot = _parse(urdf, source)
    links = [link.name for link in robot.links]
    for link in (tip,) if base is None else (tip, base):
        if link not in links:
            raise ArmError(f"{source}: no link is named {link!r}{_suggest(link, links)}")
    chain = _find_chain(robot, tip, base, source)
    parts = [_convert_joint(joint, robot.link_map[joint.child], source) for joint in chain]
    try:
        return Arm(tuple(parts))
    except ArmError as error:
        raise ArmError(f"{source}: {error}") from None


def _parse(urdf: bytes, source: str) -> Any:
    """Return the `Robot` of urdf_parser_py."""
    try:
        from urdf_parser_py import urdf as library
        from urdf_parser_py.xml_reflection import core
    except ImportError:
        raise ArmError(f"{source}: reading URDF needs urdf-parser-py: {_INSTALL}") from None
    if len(urdf) > URDF_BYTES_MAX:
        raise ArmError(f"{source}: more than {URDF_BYTES_MAX // 1000} kB, the bound of a URDF")
    complaints: list[str] = []
    report, core.on_error = core.on_error, complaints.append  # it would print them
    try:
        robot = library.URDF.from_xml_string(urdf)
    except Exception as error:  # of any kind: XML, assertions, conversions
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ArmError(f"{source}: not a valid URDF: {reason}") from None
    finally:
        core.on_error = report
    for complaint in complaints:  # the others are of tags that are not of URDF, as of simulators
        if "multiple times" in complaint:
            raise ArmError(f"{source}: {complaint}; leave one")
    _require_unique("link", (link.name for link in robot.links), source)
    _require_unique("joint", (joint.name for joint in robot.joints), source)
    return robot


def _find_chain(robot: Any, tip: str, base: str | None, source: str) -> list[Any]:
    """Return the joints from the base to the tip; raises `ArmError` if there is no such chain."""
    above: dict[str, Any] = {}
    for joint in robot.joints:
        if joint.child in above:
            raise ArmError(
                f"{source}: link {joint.child!r} is the child of the joints "
                f"{above[joint.child].name!r} and {joint.name!r}; closed chains are not possible"
            )
        above[joint.child] = joint
    chain: list[Any] = []
    link = tip
    while link != base and link in above:
        chain.insert(0, above[link])
        link = chain[0].parent
        if len(chain) > len(robot.joints):
            raise ArmError(f"{source}: the joints above link {tip!r} run in a circle")
    if base is not None and link != base:
        passed = [link, *(joint.child for joint in chain)]
        raise ArmError(
            f"{source}: link {tip!r} is not beyond {base!r}, they are on different branches; "
            f"choose the base among {', '.join(passed[:-1]) or tip}"
        )
    return chain


def _convert_joint(joint: Any, link: Any, source: str) -> Joint:
    """Return a joint of the library and the link that it moves as a part of an arm."""
    place = f"{source}: joint {joint.name!r}"
    if joint.mimic is not None:
        raise ArmError(
            f"{place} mimics {joint.mimic.joint!r}; choose a tip before it, or make it a joint of "
            "its own or fixed"
        )
    if joint.type not in _JOINT_KINDS:
        raise ArmError(
            f"{place} is {joint.type}; allowed are {', '.join(_JOINT_KINDS)}: "
            "choose a base beyond it, or make several joints of it"
        )
    limits: dict[str, Any] = {}
    if joint.limit is not None and joint.type != "fixed":
        limits = {"speed": joint.limit.velocity, "effort": joint.limit.effort}
    if joint.type in ("revolute", "prismatic"):
        if joint.limit is None:
            raise ArmError(
                f"{place} has no limits; add <limit lower= upper= velocity= effort=/>, or make it "
                "continuous"
            )
        limits |= {"lower": joint.limit.lower, "upper": joint.limit.upper}
    axis = (1.0, 0.0, 0.0) if joint.axis is None else joint.axis  # x is the default of URDF
    try:
        return Joint(
            joint.name, joint.type, _to_triple(axis), _convert_origin(joint.origin), **limits,
            **_convert_inertial(link.inertial),
        )  # fmt: skip
    except ArmError as error:
        raise ArmError(f"{source}: {error}") from None


def _convert_inertial(inertial: Any) -> dict[str, Any]:
    """Return mass, centre and inertia of a link as arguments of `Joint`."""
    if inertial is None:
        return {}
    offset, moments = _convert_origin(inertial.origin), inertial.inertia
    inertia = np.zeros((3, 3))
    if moments is not None:
        turn = offset.to_matrix()[:3, :3]
        inertia = turn @ np.array(moments.to_matrix(), np.float64) @ turn.T
    return {
        "mass": float(inertial.mass or 0.0),
        "centre": offset.position,
        "inertia": tuple(inertia[np.triu_indices(3)].tolist()),
    }


def _convert_origin(origin: Any) -> Offset:
    """Return an offset; what is left out of it is zero."""
    position, rpy = (origin and getattr(origin, name) for name in ("xyz", "rpy"))
    return Offset(_to_triple(position or (0.0,) * 3), _to_triple(rpy or (0.0,) * 3))


def _to_triple(numbers: Iterable[float]) -> tuple[float, float, float]:
    x, y, z = np.asarray(numbers, dtype=np.float64).tolist()
    return x, y, z


def _require_unique(kind: str, names: Iterable[str], source: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ArmError(f"{source}: two {kind}s are named {name!r}; give each its own name")
        seen.add(name)


def _suggest(link: str, links: list[str]) -> str:
    """Return the links that may have been meant, as the end of a message."""
    close = difflib.get_close_matches(link, links) or links[:8]
    return f"; did you mean {', '.join(close)}?" if close else "; it has no links"
