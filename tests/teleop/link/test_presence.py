"""Tokens of presence: what they say, and who has to leave."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.messages.topics import Role
from teleop.security.presence import EXCLUSIVE_ROLES, RoleStage, Token, create_nonce, find_conflict

TOKENS = st.builds(
    Token,
    role=st.sampled_from(list(Role)),
    layout=st.sampled_from([1, 2]),
    nonce=st.integers(0, 2**64 - 1),
    stage=st.sampled_from(list(RoleStage)),
    relayed=st.booleans(),
)


@given(TOKENS)
def test_a_token_survives_its_key(token):
    assert Token.from_key(token.to_key("demo")) == token


@given(st.text())
def test_a_foreign_key_is_no_token(text):
    assert Token.from_key(f"teleop/x/@/{text}") is None or text.count("/") >= 3


@pytest.mark.parametrize(
    "key",
    [
        "teleop/x/@/master/00000001/-fffffffffffffff/held",  # `int` takes these numbers
        "teleop/x/@/master/-0000001/0123456789abcdef/held",
        "teleop/x/@/master/00000001/1_23456789abcdef/held",
        "teleop/x/@/master/00000001/0123456789ABCDEF/held",
        "teleop/x/@/master/00000001/0123456789abcde\u0664/held",
        "teleop/x/@/Master/00000001/0123456789abcdef/held",
        "teleop/x/@/master/00000001/0123456789abcdef/HELD",
        "teleop/x/@/master/00000001/0123456789abcdef/held/",
        "master/00000001/0123456789abcdef/held",
        "other/x/@/master/00000001/0123456789abcdef/held",
    ],
)
def test_a_token_has_one_key(key):
    genuine = "teleop/x/@/master/00000001/0123456789abcdef/held"
    assert Token.from_key(genuine) is not None
    assert Token.from_key(key) is None


@given(TOKENS, TOKENS)
def test_of_two_that_cannot_both_be_there_exactly_one_leaves(one, two):
    both = one.role in EXCLUSIVE_ROLES and two.role in EXCLUSIVE_ROLES and one.nonce != two.nonce
    clash = both and (one.role == two.role or one.layout != two.layout)
    leaves = [find_conflict(one, [two]) is not None, find_conflict(two, [one]) is not None]
    if both:
        assert sum(leaves) == clash
    if clash and one.stage != two.stage:
        assert leaves[one.stage < two.stage] == 0 or leaves[0] == (one.stage < two.stage)
        assert leaves[0] == (one.stage < two.stage)


@given(TOKENS, TOKENS)
def test_listeners_make_nobody_leave_and_leave_only_for_another_layout(one, two):
    if two.role not in EXCLUSIVE_ROLES:
        assert find_conflict(one, [two]) is None
    if one.role not in EXCLUSIVE_ROLES and two.role in EXCLUSIVE_ROLES and one.nonce != two.nonce:
        assert (find_conflict(one, [two]) is not None) == (one.layout != two.layout)


def test_nonces_differ_and_grow():
    drawn = []
    for _ in range(200):
        drawn.append(create_nonce())
        time.sleep(1e-5)
    assert drawn == sorted(set(drawn))
