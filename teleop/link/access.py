"""Zenoh's access control of a session, generated from the table of topics.

Each process refuses, on arrival, what the certificate at the other end of the connection must not
send: messages of topics that its role does not publish, and presence tokens of another role. What
may be sent through a router is decided by that router, which has the same rules.
"""

from collections.abc import Iterable
from typing import Any

from teleop.keys.identity import (
    ALL_SESSIONS,
    OFFICE_OF,
    RIGHTS,
    Identity,
    Office,
    supervisors,
)
from teleop.link.presence import root
from teleop.link.publisher import sampled_key
from teleop.topics import SETTING, STOP, TOPICS, Role, Topic

_EVERYTHING = [
    "put", "delete", "declare_subscriber", "query", "reply", "declare_queryable",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
]  # fmt: skip
_LISTENING = ["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]


def access_control(sessions: Iterable[str]) -> dict[str, Any]:
    """Return Zenoh's `access_control` for a process, or a router, of these sessions."""
    rules: list[dict[str, Any]] = [
        {
            "id": "egress",
            "permission": "allow",
            "flows": ["egress"],
            "messages": _EVERYTHING,
            "key_exprs": ["**", "teleop/*/@/**", "teleop/*/@impair"],
        }
    ]
    policies: list[dict[str, Any]] = [{"rules": ["egress"], "subjects": ["anyone"]}]
    subjects: dict[str, dict[str, Any]] = {"anyone": {"id": "anyone"}}

    def allow(rule: str, messages: list[str], keys: list[str], names: list[str]) -> None:
        rules.append(
            {
                "id": rule,
                "permission": "allow",
                "flows": ["ingress"],
                "messages": messages,
                "key_exprs": keys,
            }
        )
        for name in names:
            subjects[name] = {"id": name, "cert_common_names": [name]}
        policies.append({"rules": [rule], "subjects": names})

    for session in sessions:
        top, tokens = f"teleop/{session}", root(session)
        routers = [_name(Office.ROUTER, session), _name(Office.ROUTER, ALL_SESSIONS)]
        allow(f"{session} router", _EVERYTHING, [f"{top}/**", f"{tokens}/**", f"{top}/@impair"],
              routers)  # fmt: skip
        everybody = [name for office in Office for name in names_of(office, session)]
        allow(f"{session} listen", _LISTENING, [f"{top}/**", f"{tokens}/**"],
              everybody)  # fmt: skip
        allow(f"{session} proof", ["declare_queryable", "reply"], [f"{tokens}/prove/**"], everybody)
        for topic in TOPICS:
            publishers = names_of_publishers(topic, session)
            keys = [f"{top}/{topic.name}"]
            if topic.sampled_hz:
                keys.append(sampled_key(keys[0]))
            allow(f"{session} {topic.name}", ["put"], keys, publishers)
        for role in Role:
            keys = [f"{tokens}/{role.name.lower()}/**"]
            if role == Role.SLAVE:
                keys.append(f"{tokens}/relay/master/**")
            allow(f"{session} token of a {role.name.lower()}", ["liveliness_token"], keys,
                  names_of(OFFICE_OF[role], session))  # fmt: skip
            allow(f"{session} challenge of a {role.name.lower()}", ["query"],
                  [f"{tokens}/prove/{role.name.lower()}/**"],
                  names_of(OFFICE_OF[role], session))  # fmt: skip
        allow(f"{session} impair", ["query"], [f"{top}/@impair"],
              names_of(Office.SUPERVISOR, session))  # fmt: skip
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": list(subjects.values()),
        "policies": policies,
    }


def names_of(office: Office, session: str) -> list[str]:
    """Return the common names of a role's certificates in a session."""
    if office is Office.SUPERVISOR:
        return sorted({name for right in RIGHTS for name in supervisors(session, right)})
    return [_name(office, session)]


def names_of_publishers(topic: Topic[Any], session: str) -> list[str]:
    """Return the common names of certificates that may publish `topic` in a session."""
    names: list[str] = []
    for office in dict.fromkeys(OFFICE_OF[role] for role in topic.publishers):
        if office is not Office.SUPERVISOR:
            names += names_of(office, session)
        elif topic is SETTING:
            names += supervisors(session, "set")
        elif topic is STOP:
            names += sorted({*supervisors(session, "stop"), *supervisors(session, "reset")})
    return names


def _name(office: Office, session: str) -> str:
    return Identity(office, session).common_name
