"""Arms from URDF: what is kept, and what is refused with place and remedy."""

import builtins
import math

import numpy as np
import pytest

from estimator.kinematics.arm import ArmError
from estimator.kinematics.urdf import read_arm
from teleop.config.arm import load_arm
from teleop.errors import UsageError
from tests.estimator.kinematics.random_arms import random_chain, write_urdf

HEAD = '<robot name="r"><link name="base"/><link name="arm"/><link name="tip"/><foreign tag="1"/>'
ENDS = '<parent link="base"/><child link="arm"/>'
LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="3"/>'
JOINT = f'<joint name="one" type="revolute">{ENDS}<axis xyz="0 0 2"/>{LIMIT}</joint>'
LAST = (
    '<joint name="two" type="fixed"><parent link="arm"/><child link="tip"/>'
    '<origin xyz="0 0 0.1"/></joint></robot>'
)
GOOD = HEAD + JOINT + LAST


def test_without_the_library_it_is_said_what_to_install(monkeypatch):
    real = builtins.__import__

    def missing(name, *rest):
        if name.startswith("urdf_parser_py"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ArmError, match=r"arm.urdf: .*pip install 'tendon-teleop\[urdf\]'"):
        read_arm(GOOD.encode(), tip="tip", source="arm.urdf")


class TestWithLibrary:
    @pytest.fixture(autouse=True)
    def _library(self):
        pytest.importorskip("urdf_parser_py")

    def test_links_have_the_mass_of_their_inertials(self):
        inertial = '<inertial><origin xyz="0 0.1 0.2"/><mass value="0.3"/><inertia ixx="1" ixy="0" '
        inertial += 'ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
        text = GOOD.replace('<link name="arm"/>', f'<link name="arm">{inertial}</link>')
        first, last = read_arm(text.encode(), tip="tip").parts
        assert (first.mass, first.centre) == (0.3, (0.0, 0.1, 0.2))
        assert (last.mass, first.inertia) == (0.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
        for wrong in ('ixx="-1"', 'ixx="nan"'):
            with pytest.raises(
                ArmError, match=r"joint one: inertia .* must be finite and negative"
            ):
                read_arm(text.replace('ixx="1"', wrong).encode(), tip="tip")

    def test_what_is_written_is_read(self, tmp_path):
        rng = np.random.default_rng(2)
        for count in range(1, 9):
            arm = random_chain(rng, count)
            file = tmp_path / "arm.urdf"
            file.write_text(write_urdf(arm))
            assert load_arm(file, tip="tip").coordinates == arm.coordinates
            read = load_arm(file, tip="tip", base="base")
            assert [p.offset for p in read.parts] == [p.offset for p in arm.parts]
            assert [p.axis for p in read.parts] == [p.axis for p in arm.parts]

    def test_the_base_shortens_the_chain(self):
        arm = read_arm((HEAD + JOINT + LAST.replace("fixed", "continuous")).encode(), tip="tip")
        assert [c.name for c in arm.coordinates] == ["one", "two"]
        assert arm.coordinates[1].upper == math.inf
        cut = (HEAD + JOINT + LAST.replace("fixed", "continuous")).encode()
        assert [c.name for c in read_arm(cut, tip="tip", base="arm").coordinates] == ["two"]

    def test_nothing_is_printed(self, capsys):
        read_arm(GOOD.encode(), tip="tip")
        assert capsys.readouterr() == ("", "")

    @pytest.mark.parametrize(
        ("text", "links", "said"),
        [
            (GOOD, {"tip": "tipp"}, "no link is named 'tipp'; did you mean tip"),
            (GOOD, {"tip": "arm", "base": "tip"}, "'arm' is not beyond 'tip'.*choose the base"),
            (GOOD[:-9], {"tip": "tip"}, "not a valid URDF"),
            (GOOD.replace(LIMIT, ""), {"tip": "tip"}, "joint 'one' has no limits; add <limit"),
            (GOOD.replace("fixed", "floating"), {"tip": "tip"}, "'two' is floating; allowed"),
            (GOOD.replace('"two"', '"one"'), {"tip": "tip"}, "two joints are named 'one'"),
            (
                GOOD.replace(LIMIT, f'{LIMIT}<mimic joint="two"/>'),
                {"tip": "tip"},
                "joint 'one' mimics 'two'; choose a tip before it",
            ),
            (
                GOOD.replace("</robot>", JOINT.replace("one", "three") + "</robot>"),
                {"tip": "tip"},
                "'arm' is the child of the joints 'one' and 'three'",
            ),
            (
                GOOD.replace('parent link="base"', 'parent link="tip"'),
                {"tip": "tip"},
                "in a circle",
            ),
            (GOOD, {"tip": "tip", "base": "arm"}, "0 coordinates, allowed are 1 to 8"),
        ],
    )
    def test_what_cannot_be_an_arm_is_refused_in_one_line(self, text, links, said):
        with pytest.raises(ArmError, match=rf"^a\.urdf: .*{said}") as refused:
            read_arm(text.encode(), source="a.urdf", **links)
        assert "\n" not in str(refused.value)

    def test_a_file_that_cannot_be_read_is_named(self, tmp_path):
        with pytest.raises(UsageError, match=r"none\.urdf: cannot be read"):
            load_arm(tmp_path / "none.urdf", tip="tip")
        file = tmp_path / "other.urdf"
        file.write_text("no xml")
        with pytest.raises(UsageError, match=r"other\.urdf: not a valid URDF"):
            load_arm(file, tip="tip")
