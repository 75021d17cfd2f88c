"""Zenoh's access control of a session, generated from the table of topics.

Each process refuses, on arrival, what the certificate at the other end of the connection must not
send: messages of topics that its role does not publish, presence tokens of another role, any token
or queryable of a listener, and subscribers of anything but a topic. Each would take memory, and
Zenoh sends nothing while it removes those of a connection that ends. What may be sent through a
router is decided by that router, which has the same rules.
"""

from collections.abc import Iterable
from typing import Any

from teleop.link.publisher import build_sampled_key
from teleop.messages.topics import SETTING, STOP, TOPICS, Role, Topic
from teleop.security.identity import (
    ALL_SESSIONS,
    CERTIFICATE_ROLES,
    RIGHTS,
    CertificateRole,
    Identity,
    list_supervisor_names,
)
from teleop.security.presence import LISTENER_ROLES, build_token_root

_ALL_MESSAGES = [
    "put", "delete", "declare_subscriber", "query", "reply", "declare_queryable",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
]  # fmt: skip
_LIVELINESS_MESSAGES = ["liveliness_query", "declare_liveliness_subscriber"]


def build_access_control(sessions: Iterable[str]) -> dict[str, Any]:
    """Return Zenoh's `build_access_control` for a process, or a router, of these sessions."""
    rules: list[dict[str, Any]] = [
        {
            "id": "egress",
            "permission": "allow",
            "flows": ["egress"],
            "messages": _ALL_MESSAGES,
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
        top, tokens = f"teleop/{session}", build_token_root(session)
        routers = [
            _build_common_name(CertificateRole.ROUTER, session),
            _build_common_name(CertificateRole.ROUTER, ALL_SESSIONS),
        ]
        allow(f"{session} router", _ALL_MESSAGES, [f"{top}/**", f"{tokens}/**", f"{top}/@impair"],
              routers)  # fmt: skip
        everybody = [name for role in CertificateRole for name in list_common_names(role, session)]
        listeners = {
            _build_common_name(CERTIFICATE_ROLES[role], session) for role in LISTENER_ROLES
        }
        members = [name for name in everybody if name not in listeners]
        allow(f"{session} watch", _LIVELINESS_MESSAGES, [f"{tokens}/**"], everybody)
        allow(f"{session} proof", ["declare_queryable", "reply"], [f"{tokens}/prove/**"], members)
        subscribers: list[str] = []
        for topic in TOPICS:
            publishers = list_publisher_names(topic, session)
            keys = [f"{top}/{topic.name}"]
            if topic.sampled_hz:
                keys.append(build_sampled_key(keys[0]))
            subscribers += keys
            allow(f"{session} {topic.name}", ["put"], keys, publishers)
        allow(f"{session} listen", ["declare_subscriber"], subscribers, everybody)
        for name in everybody:
            groups = list_holder_groups(name)
            if groups:
                keys = [f"{tokens}/{group}/**" for group in groups]
                if Role.SLAVE.name.lower() in groups:
                    keys.append(f"{tokens}/relay/master/**")
                if name in members:
                    allow(f"token of {name}", ["liveliness_token"], keys, [name])
                allow(f"challenge of {name}", ["query"],
                      [f"{tokens}/prove/{group}/**" for group in groups], [name])  # fmt: skip
        allow(f"{session} impair", ["query"], [f"{top}/@impair"],
              list_common_names(CertificateRole.SUPERVISOR, session))  # fmt: skip
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": list(subjects.values()),
        "policies": policies,
    }


def list_common_names(role: CertificateRole, session: str) -> list[str]:
    """Return the common names of a role's certificates in a session."""
    if role is CertificateRole.SUPERVISOR:
        return sorted({name for right in RIGHTS for name in list_supervisor_names(session, right)})
    return [_build_common_name(role, session)]


def list_holder_groups(name: str) -> list[str]:
    """Return the groups of tokens (`Token.group`) of the holder of a common name."""
    holder = Identity.parse(name)
    return [
        f"{role.name.lower()}{holder.limit}"
        for role in Role
        if CERTIFICATE_ROLES[role] is holder.role
    ]


def list_publisher_names(topic: Topic[Any], session: str) -> list[str]:
    """Return the common names of certificates that may publish `topic` in a session."""
    names: list[str] = []
    for role in dict.fromkeys(CERTIFICATE_ROLES[publisher] for publisher in topic.publishers):
        if role is not CertificateRole.SUPERVISOR:
            names += list_common_names(role, session)
        elif topic is SETTING:
            names += list_supervisor_names(session, "set")
        elif topic is STOP:
            names += sorted(
                {*list_supervisor_names(session, "stop"), *list_supervisor_names(session, "reset")}
            )
    return names


def _build_common_name(role: CertificateRole, session: str) -> str:
    return Identity(role, session).common_name
