"""`teleop devices` against the fake: what is listed, probed, tried, and kept."""

import pytest
import yaml

from master.devices.hid import command, force_signs, search
from master.devices.hid.command import OperatorDialogue
from studies.hid import descriptors
from studies.hid.virtual.dualsense import DualSense
from studies.hid.virtual.openffboard import OpenFFBoard
from studies.hid.virtual.spacemouse import SpaceMouse
from teleop.cli import commands


@pytest.fixture(autouse=True)
def short_rests(monkeypatch):
    monkeypatch.setattr(force_signs, "REST_S", 0.05)


class Free(OpenFFBoard):
    """A board whose sticks give way to its motors, wired one way or the other."""

    wired = (1.0, -1.0)

    def __init__(self):
        super().__init__(descriptors.openffboard())
        self._before = None

    def build_inputs(self, now):
        dt = 0.0 if self._before is None else now - self._before
        self._before = now
        for axis, (way, share) in enumerate(zip(self.wired, self.pushes[-1].force, strict=True)):
            moved = self.axes[axis] + 5.0 * way * share * dt
            self.axes[axis] = min(max(moved, -1.0), 1.0)
        return super().build_inputs(now)


class Someone:
    """A person with answers ready; everything said is kept."""

    def __init__(self, *answers):
        self.said, self._answers = [], list(answers)
        self.person = OperatorDialogue(self.said.append, self.answer)

    def answer(self, question):
        self.said.append(question)
        if not self._answers:
            raise EOFError
        return self._answers.pop(0)


def found_in(file):
    return force_signs.load(file).find_signs(search.find_device("", "auto").pusher)


def teleop(capsys, *words):
    code = commands.main(["devices", *words])
    out = capsys.readouterr()
    return code, out.out, out.err


def test_a_list_says_what_is_attached_and_which_driver_fits(hidraw, capsys):
    assert teleop(capsys, "list") == (0, "no HID device attached\n", "")
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    hidraw.plug(SpaceMouse(descriptors.spacemouse()), usages=((1, 8),))
    code, out, _ = teleop(capsys, "list")
    head, board, mouse = out.splitlines()
    assert code == 0
    assert head.split()[:3] == ["path", "model", "driver"]
    assert board.split()[1:4] == ["1209:ffb0", "pid", "yes"]
    assert mouse.split()[2] == "spacemouse"


def test_a_probe_reads_the_descriptor_out_and_counts_reports(hidraw, capsys):
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    code, out, _ = teleop(capsys, "probe", "--seconds", "0.25")
    assert code == 0
    assert "driver pid: fits" in out
    assert "Set Constant Force" in out
    rate = float(out.rpartition(": ")[2].split(" Hz")[0])
    assert 500.0 < rate < 2000.0  # 1000 Hz; a busy machine reads in bunches


def test_what_cannot_even_be_described_is_listed_and_probed_with_the_remedy(hidraw, capsys):
    hidraw.plug(OpenFFBoard(descriptors.openffboard())).permitted = False
    assert "no: teleop devices rules" in teleop(capsys, "list")[1]
    code, out, _ = teleop(capsys, "probe")
    assert code == 0
    assert "cannot be opened; teleop devices rules" in out


def bytes_in(text):
    return bytes.fromhex(yaml.safe_load(text)["descriptor"])


def test_a_dump_has_every_byte_of_the_descriptor_and_no_serial_number(hidraw, capsys, tmp_path):
    board = OpenFFBoard(descriptors.openffboard())
    hidraw.plug(board)
    code, out, _ = teleop(capsys, "dump")
    assert code == 0
    assert bytes_in(out) == board.descriptor
    known = yaml.safe_load(out)
    assert (known["vendor"], known["product"], known["release"]) == ("1209", "ffb0", "0100")
    assert (known["bytes"], known["name"]) == (len(board.descriptor), board.name)
    assert known["drivers"]["pid"] == "fits"
    assert board.serial not in out
    file = tmp_path / "dump.yaml"
    assert teleop(capsys, "dump", "1209:ffb0", "--out", str(file))[1] == f"written to {file}\n"
    assert bytes_in(file.read_text()) == board.descriptor


def test_the_sign_that_is_kept_makes_a_force_push_that_way(hidraw, tmp_path):
    """A positive force then moves the axis to larger values, however it is wired."""
    for wired in ((-1.0, 1.0), (1.0, -1.0)):
        board = Free()
        board.wired = wired
        node = hidraw.plug(board)
        file = tmp_path / f"{wired}.yaml"
        command.run_device_test("", "auto", file, 0.1, Someone("", "").person)
        kept = found_in(file)
        line = command.DeviceConnection(search.find_device("", "auto"), command.PidConfig())
        for place, axis in enumerate("xy"):
            share = [0.0, 0.0]
            share[place] = 0.1 * kept[axis]
            before = board.axes[place]
            line.post(tuple(share))
            line.read(0.0)
            for _ in range(100):
                line.post(tuple(share))
                command.time.sleep(0.001)
                line.read(0.0)
            assert board.axes[place] > before
        line.end(1.0)
        hidraw.unplug(node)


def test_what_does_not_move_is_asked_about(hidraw, tmp_path, monkeypatch):
    monkeypatch.setattr(force_signs, "HOLD_S", 0.05)
    monkeypatch.setattr(force_signs, "PUSH_S", 0.05)
    hidraw.plug(DualSense(descriptors.dualsense_usb()))
    file, someone = tmp_path / "signs.yaml", Someone("", "", "n", "what?", "s", "s")
    command.run_device_test("", "auto", file, 0.1, someone.person)
    assert found_in(file) == {"l2": 1}  # asked to push to smaller values, it did; r2 was left out
    assert any(line.startswith("r2: sign not found") for line in someone.said)


def test_nobody_to_answer_is_one_line_and_leaves_no_force(hidraw, tmp_path, capsys, monkeypatch):
    node = hidraw.plug(Free())
    monkeypatch.setattr("builtins.input", Someone().answer)
    monkeypatch.setattr(command, "OperatorDialogue", lambda: Someone().person)
    code, _, err = teleop(capsys, "test", "--seconds", "0.1", "--signs", str(tmp_path / "s.yaml"))
    assert code == 2
    assert err.count("\n") == 1
    assert "needs a terminal" in err
    assert node.force() == (0.0, 0.0)


@pytest.mark.parametrize("words", [(), ("probe", "--seconds", "-1"), ("test", "--driver", "mine")])
def test_wrong_words_are_one_line(hidraw, capsys, words):
    code, _, err = teleop(capsys, *words)
    assert code == 2
    assert err.count("\n") == 1
