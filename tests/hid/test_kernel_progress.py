"""The kernel run waits for a machine as long as results come, and no longer."""

from studies.kernel.__main__ import HANGING_S, SILENCE_MAX_S, follow


class World:
    """Machines that say what they are told to at their times, and a clock.

    They get a share of a processor.
    """

    def __init__(self, *scripts, share=1.0):
        self.now, self.share = 0.0, share
        self.machines = [Script(self, *script) for script in scripts]

    def sleep(self, seconds):
        self.now += seconds

    def results(self):
        return list(follow(self.machines, lambda: self.now, self.sleep))


class Script:
    """A machine: the times at which it says something, and when it ends."""

    def __init__(self, world, times, ends):
        self.world, self.times, self.ends = world, list(times), ends

    @property
    def worked_s(self):
        return self.world.now * self.world.share

    @property
    def runs(self):
        return self.ends is None or self.world.now < self.ends

    def news(self):
        due = [time for time in self.times if time <= self.world.now]
        self.times = self.times[len(due) :]
        return [
            {"check": "end" if self.ends is not None and not self.times else "loop", "figures": {}}
            for _ in due
        ]


def troubles(results):
    return [line["trouble"] for line in results if "trouble" in line]


def test_a_slow_machine_is_waited_for_as_long_as_it_comes_on():
    step = 0.9 * SILENCE_MAX_S / 0.2
    times = [step * k for k in range(1, 21)]
    world = World((times, times[-1] + 1.0), ([5.0], 6.0), share=0.2)
    results = world.results()
    assert len(results) == 21
    assert troubles(results) == []
    assert world.now > times[-1]


def test_a_machine_that_says_nothing_more_is_given_up_and_named():
    world = World(([10.0, 20.0], None), ([5.0, 100.0, 200.0, 300.0], 301.0))
    (trouble,) = troubles(world.results())
    assert "machine 1" in trouble
    assert "after loop" in trouble
    assert 300.0 < world.now < 310.0


def test_one_that_never_boots_is_given_up():
    world = World(([], None))
    (trouble,) = troubles(world.results())
    assert f"no result for {SILENCE_MAX_S:.0f} s" in trouble
    assert "after the start" in trouble
    assert SILENCE_MAX_S <= world.now < SILENCE_MAX_S + 1.0


def test_one_that_does_not_even_work_is_given_up():
    world = World(([], None), share=0.0)
    assert len(troubles(world.results())) == 1
    assert HANGING_S <= world.now < HANGING_S + 1.0


def test_one_that_ends_without_saying_so_is_no_success():
    world = World(([10.0], None))
    world.machines[0].ends = 20.0
    world.machines[0].times = [10.0, 30.0]
    (trouble,) = troubles(world.results())
    assert "ended too early" in trouble
