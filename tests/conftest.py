"""What all tests may ask for."""

import atexit
import gc
import os
import shutil
import signal
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings
from pytest_rerunfailures import StatusDB

from tests.root import ROOT

gc.disable()  # until all is collected: pytest rewrites asserts in trees of millions of objects
# keys of this test run, also of the processes that it starts; not those of the user
KEYS = os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="teleop-tests-")
atexit.register(shutil.rmtree, KEYS, ignore_errors=True)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup, commands would go on ignoring it
settings.register_profile("short", deadline=None, max_examples=50)  # a busy machine takes long
settings.load_profile("short")
REAL_TIME = (  # sessions and loops on the clock, not what only waits for sockets
    "examples/test_session_examples.py",
    "system/test_certificates.py",
    "system/test_faults.py",
    "system/test_namespaces.py",
    "system/test_replay_rig.py",
    "system/test_rogue.py",
    "system/test_ros_run.py",
    "system/test_run.py",
    "system/test_session_object.py",
    "system/test_side_by_side.py",
    "system/test_stop.py",
    "system/test_view_access.py",  # a browser draws in software
    "system/test_view_page.py",
    "drivers/test_cia402.py",
    "drivers/test_composed.py",
    "drivers/test_dynamixel.py",
    "drivers/test_jobs.py",
    "drivers/test_microcontroller.py",
    "master/ros/test_operator.py",
    "master/test_command.py",
    "master/test_unplug.py",
    "master/hid/test_command.py",
    "master/hid/test_device.py",
    "master/hid/test_guard.py",
    "master/hid/test_writer.py",
    "slave/test_command.py",
    "teleop/link/test_frozen_and_killed.py",
    "teleop/ros/test_live.py",
)
ALONE = (  # of these: limits in milliseconds, and sessions with the time-outs of a real one
    "docs/test_tutorials.py",
    "examples/test_session_examples.py",
    "system/test_certificates.py",
    "system/test_faults.py",
    "system/test_namespaces.py",
    "system/test_rogue.py",
    "system/test_run.py",
    "system/test_side_by_side.py",
    "system/test_stop.py",
    "system/test_view_page.py",
)
FIRST = (  # the longest, which nobody is to be left alone with at the end
    "slave/simulation/test_arm.py",
    "estimator/diagnosis/test_simple_models.py",
    "estimator/test_pair_adaptation.py",
    "slave/test_process.py",
    "slave/calibration/test_calibrate_arm.py",
    "drivers/test_can_faults.py",
    "teleop/cli/diagnose/test_diagnose_command.py",
    "tick/test_arm_session.py",
    "teleop/coupling/test_closed_loop.py",
    "teleop/link/test_router.py",
    "estimator/diagnosis/test_free_functions.py",
    "estimator/test_function_cache.py",
    "estimator/kinematics/test_hand_map.py",
    "estimator/routing/test_tensions.py",
    "teleop/experiment/test_run.py",
    "system/test_session_object.py",
    "drivers/test_cia402.py",
    "system/test_replay_rig.py",
    "teleop/link/test_frozen_and_killed.py",
)
NO_CLOCK = (  # of what keeps hands safe: a failure is one, however seldom
    "teleop/coupling",
    "master/test_gate.py",
    "slave/fault_detection",
    "slave/test_gate.py",
    "teleop/test_black_channel.py",
    "teleop/test_session.py",
    "tick",
)


@cache  # asked three times of each of thousands of tests
def is_in(path: Path, places: tuple[str, ...]) -> bool:
    return any(path.is_relative_to(Path(__file__).parent / place) for place in places)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return more workers than processors: a third of the time, a test waits; half on a clock."""
    workers = 4 if config.option.markexpr.startswith("real_time") else 3  # of two processors
    return max(2, workers * (os.cpu_count() or 1) // 2)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Let workers keep no count of crashes: 45 ms a test, as TCP delays its small packets.

    With `--dist loadfile` it decides nothing: a test that ends its worker has failed.
    """
    if hasattr(session.config, "workerinput"):
        session.config.failures_db.sock.close()
        session.config.failures_db = StatusDB()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file of which nothing is asked for: that takes longer than many a test."""
    if not (collection_path.name.startswith("test_") and collection_path.suffix == ".py"):
        return None
    asked_for = config.option.markexpr
    if asked_for.startswith("alone"):
        is_other = not is_in(collection_path, ALONE)
    elif asked_for.startswith("real_time"):  # a file may mark some of its tests
        is_other = not (
            is_in(collection_path, REAL_TIME) or "real_time" in collection_path.read_text("utf-8")
        )
    else:
        is_other = asked_for.startswith("not real_time") and is_in(collection_path, REAL_TIME)
    return is_other or None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what has a clock, what has the processors to itself, and what is never run again.

    Files come in the order in which they are to be begun: `FIRST`, then those of most tests.
    """
    tests = Counter(item.path for item in items)
    first = {Path(__file__).parent / place: number for number, place in enumerate(FIRST)}
    items.sort(key=lambda item: (first.get(item.path, len(first)), -tests[item.path]))
    for item in items:
        if is_in(item.path, REAL_TIME):
            item.add_marker("real_time")
        if is_in(item.path, ALONE) and item.get_closest_marker("real_time"):
            item.add_marker("alone")
        if is_in(item.path, NO_CLOCK):
            item.add_marker(pytest.mark.flaky(reruns=0))


def pytest_collection_finish() -> None:
    gc.set_threshold(50_000)  # numba makes millions of objects: a tenth of its time was collecting
    gc.enable()


@pytest.fixture(scope="module", autouse=True)
def freeze_objects() -> None:
    """Spare the garbage collector a million objects of imports and of the compiler, each time."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def demo_config() -> Path:
    return ROOT / "configs" / "demo.yaml"


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of measured data, which is not part of the project; skips without it."""
    folder = Path(os.environ.get("TELEOP_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no measured data at {folder} (set TELEOP_SHARED_DATA)")
    return folder
