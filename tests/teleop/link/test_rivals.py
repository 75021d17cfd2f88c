"""Whoever must not be there, beside one who is: the second master, another version."""

import threading

import pytest

from teleop.errors import PeerError
from teleop.link import Link
from teleop.link import link as link_module
from teleop.messages.messages import LAYOUT
from teleop.messages.topics import Role
from tests.teleop.link.bench import free_config, oldest, pump, session, wait_until


@pytest.mark.usefixtures("true_settling")
def test_a_second_slave_on_the_same_endpoint_is_refused(config):
    with (
        Link(config, "test", Role.SLAVE),
        pytest.raises(PeerError, match=r"session 'test' has a slave already"),
        Link(config, "test", Role.SLAVE),
    ):
        pass


@pytest.mark.usefixtures("true_settling")
def test_a_second_master_from_another_machine_is_refused_and_the_first_stays(config):
    elsewhere = free_config(slave=config.slave)
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        late = oldest(Link(elsewhere, "test", Role.MASTER))
        with pytest.raises(PeerError, match=r"has a master already"), late:
            pass
        for link in (slave, master):
            link.check_peers()
        pump(master, slave)


@pytest.mark.usefixtures("true_settling")
def test_of_two_masters_started_at_once_one_runs(config):
    opened = []
    refused = []
    barrier = threading.Barrier(2)

    def start(mine):
        link = Link(mine, "test", Role.MASTER)
        barrier.wait()
        try:
            opened.append(link.__enter__())
        except PeerError as error:
            refused.append(error)

    with Link(config, "test", Role.SLAVE):
        configs = config, free_config(slave=config.slave)
        threads = [threading.Thread(target=start, args=(mine,)) for mine in configs]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for link in opened:
            link.__exit__(None, None, None)
    assert (len(opened), len(refused)) == (1, 1)


def test_two_masters_that_met_only_later_are_told_apart_while_running(config):
    other = free_config(slave=config.slave)
    with Link(config, "test", Role.MASTER) as older, Link(other, "test", Role.MASTER) as younger:
        for link in (older, younger):
            link.check_peers()
        with Link(config, "test", Role.SLAVE):

            def younger_is_refused():
                try:
                    younger.check_peers()
                except PeerError:
                    return True
                return False

            wait_until(younger_is_refused)
            older.check_peers()


@pytest.mark.parametrize("role", [Role.MASTER, Role.RECORDER])
@pytest.mark.usefixtures("true_settling")
def test_another_message_layout_is_refused_with_both_numbers(config, monkeypatch, role):
    with Link(config, "test", Role.SLAVE) as slave:
        monkeypatch.setattr(link_module, "LAYOUT", 0xABCDEF01)
        with (
            pytest.raises(PeerError, match=rf"{LAYOUT:08x}.*abcdef01.*same version"),
            Link(config, "test", role),
        ):
            pass
        slave.check_peers()
