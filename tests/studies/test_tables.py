"""No table that a program could write is read wrongly in silence."""

from studies import tables


def test_random_tables_are_read_as_written_or_refused():
    outcomes, notes = tables.read_tables(100, seed=0)
    assert not [note for note in notes if note[1] == "wrong"]
    assert outcomes["read"] > 80
