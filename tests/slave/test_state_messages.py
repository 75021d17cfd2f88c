"""What the messages say in numbers is what the estimator means by them."""

from estimator.law.transmission import Phase
from estimator.online.online import Status
from teleop.messages.messages import PHASE_NAMES, STATUS_NAMES


def test_the_bits_of_a_status_have_the_estimators_names_and_places():
    flags = [flag for flag in Status if flag]
    assert [flag.name.lower().replace("_", " ") for flag in flags] == list(STATUS_NAMES)
    assert [flag.value for flag in flags] == [1 << bit for bit in range(len(STATUS_NAMES))]


def test_a_phase_counts_the_names_of_phases():
    assert [phase.value for phase in Phase] == list(range(len(PHASE_NAMES)))
