"""The judge of the kernel run sees what is wrong. (The run itself is `make test-kernel`.)"""

import pytest

from studies.hid.virtual.device import Push
from studies.kernel.cases import CASES
from studies.kernel.judge import Sent, WrongError, echoes, reports_lost

BOARD, PAD = CASES[0], next(case for case in CASES if case.name == "dualsense")
SENT = [Sent(n * 1e-3, BOARD.force(n)) for n in range(400)]


def felt(sent, change=lambda force: force, late=0.0003):
    """Return what a device does whose axes are written one after the other."""
    pushes, y = [], 0.0
    for time, force in sent:
        pushes += [Push(time + late, change((force[0], y))), Push(time + late, change(force))]
        y = force[1]
    return pushes


def test_each_force_is_found_with_its_delay_and_missed_ones_are_counted_on_each_axis():
    delays, missed = echoes(SENT, felt(SENT), (1, 1))
    assert missed == 0
    assert max(delays) == pytest.approx(0.0003)
    assert echoes(SENT, felt(SENT[:100] + SENT[101:]), (1, 1))[1] == 2
    assert echoes(SENT, [], (1, 1))[1] == 2 * len(SENT)


@pytest.mark.parametrize(
    "change",
    [
        lambda f: (-f[0], f[1]),
        lambda f: (f[1], f[0]),
        lambda f: (f[0], 0.9 * f[1]),
        lambda f: (f[0] + 0.05, f[1]),
        lambda f: (0.0, 0.0) if f == SENT[50].force else f,
    ],
    ids=["sign", "axis", "magnitude", "offset", "gap"],
)
def test_a_force_that_nobody_wrote_is_an_error(change):
    with pytest.raises(WrongError, match="nobody wrote"):
        echoes(SENT, felt(SENT, change), (1, 1))


@pytest.mark.parametrize("case", [BOARD, PAD], ids=lambda case: case.name)
def test_the_hand_is_known_again_and_what_is_left_out_is_counted(case):
    way = [case.hand(n) for n in range(700, 1500)]
    assert reports_lost(case, way) == 0
    assert reports_lost(case, way[:100] + way[103:]) == 3
    with pytest.raises(WrongError, match="no such position"):
        reports_lost(case, [*way[:100], way[50], *way[100:]])
