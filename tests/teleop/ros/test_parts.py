"""Parts of `teleop ros` that need no network."""

import math
import re

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from teleop.cli import commands
from teleop.config.loading import load
from teleop.errors import UsageError
from teleop.link import LinkConfig
from teleop.messages.messages import MESSAGES, Sheath, pad_values
from teleop.ros.command import build_package_files
from teleop.ros.config import RosConfig, check_ports
from teleop.ros.frames import compute_tip_pose, to_quaternion
from teleop.ros.message_types import load_typestore


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("router=tcp/10.0.0.1:7447", "loopback"),
        ("router=tls/127.0.0.1:7447", "loopback"),
        ("router=127.0.0.1", "not an endpoint"),
        ("domain=300", "0 to 232"),
        ("prefix=lab", "such as /lab"),
        ("rate_hz=5000", "1 to 500"),
        ("node='a b'", "letters"),
        ("topics=[slave/measured_jp]", "slave/measured_js"),
    ],
)
def test_a_wrong_config_is_one_line_with_the_key(text, words):
    with pytest.raises(UsageError, match=rf"ros\.{text.split('=')[0]}.*{re.escape(words)}"):
        load(None, RosConfig, "ros", [f"ros.{text}"])


def test_the_port_of_the_router_is_not_that_of_the_link():
    check_ports(RosConfig().router, LinkConfig())
    with pytest.raises(UsageError, match=r"link\.slave has this port"):
        check_ports("tcp/localhost:7500", LinkConfig(slave="127.0.0.1:7500"))
    assert commands.main(["ros", "--set", "link.master=127.0.0.1:7447"]) == 2


def test_the_package_declares_the_messages_that_are_sent(tmp_path, capsys):
    assert commands.main(["ros", "--package", str(tmp_path)]) == 0
    root = tmp_path / "tendon_teleop"
    assert str(root) in capsys.readouterr().out
    store = load_typestore()
    for cls in MESSAGES:
        text = (root / "msg" / f"{cls.__name__}.msg").read_text()
        name = f"tendon_teleop/msg/{cls.__name__}"
        (definition,) = get_types_from_msg(text, name).values()
        assert definition == store.fielddefs[name]
        assert f'"msg/{cls.__name__}.msg"' in (root / "CMakeLists.txt").read_text()
    assert "[N]" in (root / "msg" / "SlaveState.msg").read_text()
    assert set(build_package_files()) == {str(p.relative_to(root)) for p in root.rglob("*.*")}


def matrix(q):
    """The rotation of a unit quaternion, from the product q v q*."""
    w, v = q.w, np.array([q.x, q.y, q.z])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def test_a_quaternion_is_the_rotation_of_its_matrix():
    rng = np.random.default_rng(5)
    for _ in range(200):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        if rng.integers(2):  # half a turn, where the scalar part vanishes
            axis = rotation[0]
            rotation = 2 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_allclose(matrix(to_quaternion(rotation)), rotation, atol=1e-7)


def test_a_tip_lies_where_its_sheath_ends():
    quarter = Sheath(
        sections=1,
        section_length=pad_values((0.5 * math.pi * 0.2,), 16),
        section_radius=pad_values((0.2,), 16),
    )
    tip = compute_tip_pose(quarter)
    np.testing.assert_allclose(tip[:3, 3], (0.2, 0.2, 0.0), atol=1e-12)
    np.testing.assert_allclose(tip[:3, 0], (0, 1, 0), atol=1e-7)
    assert (compute_tip_pose(Sheath()) == np.eye(4)).all()
