"""A session, and what the view makes of it."""

import pytest

from tests.teleop.view.made_session import Session, save


@pytest.fixture(scope="package")
def session():
    return Session()


@pytest.fixture(scope="package")
def saved(session, tmp_path_factory):
    """The session fed in blocks of 40 ms, and read back."""
    return save(session.messages, tmp_path_factory.mktemp("view") / "session.rrd")
