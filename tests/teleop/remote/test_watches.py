"""A watch is lost when it falls silent or vanishes, and not when it leaves."""

from hypothesis import given
from hypothesis import strategies as st

from teleop.remote.request_listener import SILENCE_S, Heartbeat, update_watches

MS = 1_000_000
SILENT = round(SILENCE_S * 1e9)


def here(_nonce):
    return True


def gone(_nonce):
    return False


def armed(now=0, watch=7, present=here):
    watches, lost = update_watches((), [Heartbeat(watch, now, leaves=False)], present, now)
    assert not lost
    assert [one.watch for one in watches] == [watch]
    return watches


def test_a_vanished_token_is_a_loss_at_once():
    assert update_watches(armed(), [], gone, 1 * MS) == ((), True)


def test_a_beat_may_come_before_its_token_but_the_token_may_not_vanish_then():
    watches = armed(present=gone)
    watches, lost = update_watches(watches, [], gone, 1 * MS)
    assert not lost
    watches, lost = update_watches(watches, [], here, 2 * MS)
    assert not lost
    assert update_watches(watches, [], gone, 3 * MS) == ((), True)


def test_one_that_leaves_is_not_missed():
    watches, lost = update_watches(armed(), [Heartbeat(7, 1 * MS, leaves=True)], gone, 1 * MS)
    assert (watches, lost) == ((), False)
    assert update_watches(watches, [], gone, 10 * SILENT) == ((), False)


def test_of_several_each_counts():
    watches, _ = update_watches(armed(), [Heartbeat(8, 0, leaves=False)], here, 0)
    watches, lost = update_watches(watches, [Heartbeat(8, SILENT, leaves=False)], here, SILENT + 1)
    assert lost
    assert [one.watch for one in watches] == [8]


@given(st.lists(st.tuples(st.integers(0, 400), st.sampled_from(["beat", "leave", "nothing"]))))
def test_it_is_lost_exactly_when_it_was_silent_for_too_long(script):
    watches, now, heard = (), 0, None
    for wait_ms, what in script:
        now += wait_ms * MS
        beats = [] if what == "nothing" else [Heartbeat(7, now, leaves=what == "leave")]
        watches, lost = update_watches(watches, beats, here, now)
        if what != "nothing":
            heard = now if what == "beat" else None
            assert not lost
        else:
            assert lost == (heard is not None and now - heard > SILENT)
            heard = None if lost else heard
        assert bool(watches) == (heard is not None)
