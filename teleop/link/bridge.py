"""A bridge between the two sides of a session that are not connected directly.

Each side connects to one bank of it, in place of its peer. Messages received by a bank go to the
bridge's owner, who decides what is forwarded. Bytes are forwarded unchanged, with the original
senders, sequence numbers, checksums and tags: the bridge has the certificate of a router, and makes
no message of its own.
"""

import json
from collections.abc import Callable
from typing import Any

import zenoh

from teleop.errors import TeleopError
from teleop.link.admission import build_challenge_key
from teleop.link.config import LinkConfig
from teleop.link.network import declare_publisher, load_credentials, open_session
from teleop.messages.topics import TOPICS, Topic
from teleop.runtime.clock import now_ns
from teleop.security import CertificateRole
from teleop.security.access import build_access_control
from teleop.security.presence import build_token_root

ANSWER_S = 3.0  # timeout of a request to the bridge

SendCallback = Callable[[bytes], None]
Handler = Callable[[Topic[Any], bytes], None]


class BridgeEnd:
    """One end of a bridge: receives from one side, and sends to it for the other.

    `listen` and `connect` are endpoints, as of the peer that it replaces; `tokens_changed` is
    called from Zenoh's thread when a presence token appears or vanishes.
    """

    def __init__(
        self,
        config: LinkConfig,
        session: str,
        listen: list[str],
        connect: list[str],
        tokens_changed: Callable[[], None],
    ) -> None:
        self._session = session
        access = None if config.insecure else build_access_control([session])
        self._zenoh: Any = open_session(
            load_credentials(config, session, CertificateRole.ROUTER),
            listen,
            connect,
            access=access,
        )
        self._remote = zenoh.Locality.REMOTE  # not from or to ourselves, to avoid loops
        self._publishers: dict[str, Any] = {
            topic.name: declare_publisher(
                self._zenoh, self._build_key(topic), topic.live, patient=False, to_remote=True
            )
            for topic in TOPICS
        }
        self._subscribers: dict[str, Any] = {}
        self._tokens: frozenset[str] = frozenset()
        self._mirrored: dict[str, Any] = {}
        self._tokens_changed = tokens_changed
        self._liveliness = self._zenoh.liveliness()
        self._watch: Any = self._liveliness.declare_subscriber(
            f"{build_token_root(session)}/**", self._on_token, history=True
        )

    def close(self) -> None:
        """Close this side."""
        self._watch.undeclare()
        self._zenoh.close()

    def put(self, topic: Topic[Any]) -> SendCallback:
        """Return the function that publishes a message of `topic` on this side, with its tags."""
        put, size = self._publishers[topic.name].put, topic.message.schema.size

        def forward(data: bytes) -> None:
            put(data[:size], attachment=data[size:] or None)

        return forward

    def has_listener(self, topic: Topic[Any]) -> bool:
        """Return whether anyone on this side subscribes to `topic`."""
        return bool(self._publishers[topic.name].matching_status.matching)

    def follow(self, topic: Topic[Any], wanted: bool, handler: Handler) -> None:
        """Subscribe to `topic` on this side, or unsubscribe."""
        subscriber = self._subscribers.get(topic.name)
        if wanted and subscriber is None:
            direct: Any = zenoh.handlers.Callback(  # no thread in between, which would queue too
                lambda sample: handler(topic, _append_tags(sample)), indirect=False
            )
            self._subscribers[topic.name] = self._zenoh.declare_subscriber(
                self._build_key(topic), direct, allowed_origin=self._remote
            )
        elif not wanted and subscriber is not None:
            self._subscribers.pop(topic.name).undeclare()

    @property
    def tokens(self) -> frozenset[str]:
        """Presence keys on this side, without our own."""
        return self._tokens - self._mirrored.keys()

    def announce(self, tokens: frozenset[str]) -> None:
        """Announce exactly these keys on this side."""
        for key in self._mirrored.keys() - tokens:
            self._mirrored.pop(key).undeclare()
        for key in tokens - self._mirrored.keys():
            self._mirrored[key] = None  # before its token arrives here
            self._mirrored[key] = self._liveliness.declare_token(key)

    def pass_challenges_to(self, other: "BridgeEnd") -> None:
        """Pass challenges from this side to the other one, and their answers back.

        They are not delayed, nor lost: what is cut has no tokens that could be challenged.
        """

        def on_query(query: Any) -> None:
            def on_reply(reply: Any) -> None:
                if reply.ok is not None:
                    query.reply(reply.ok.key_expr, reply.ok.payload)

            other._zenoh.get(
                query.key_expr,
                zenoh.handlers.Callback(on_reply, indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=ANSWER_S,
                payload=query.payload,
                allowed_destination=self._remote,
            )

        direct: Any = zenoh.handlers.Callback(on_query, indirect=False)
        self._challenges: Any = self._zenoh.declare_queryable(
            build_challenge_key(self._session, "*", "*"), direct, allowed_origin=self._remote
        )

    def serve(self, answer: Callable[[str], dict[str, Any]]) -> None:
        """Answer requests of `send_request`; a `TeleopError` is raised at the caller."""

        def on_query(query: Any) -> None:
            reply: dict[str, Any]
            try:
                reply = {"answer": answer(query.payload.to_bytes().decode(errors="replace"))}
            except TeleopError as error:
                reply = {"error": str(error)}
            query.reply(query.key_expr, json.dumps(reply))

        self._queryable: Any = self._zenoh.declare_queryable(
            _build_control_key(self._session), on_query
        )

    def _build_key(self, topic: Topic[Any]) -> str:
        return f"teleop/{self._session}/{topic.name}"

    def _on_token(self, sample: Any) -> None:
        key = str(sample.key_expr)
        came = sample.kind == zenoh.SampleKind.PUT
        self._tokens = self._tokens | {key} if came else self._tokens - {key}
        self._tokens_changed()


def _append_tags(sample: Any) -> bytes:
    """Return a message with the tags behind it."""
    data: bytes = sample.payload.to_bytes()
    tags = sample.attachment
    return data if tags is None else data + tags.to_bytes()


def send_request(config: LinkConfig, session: str, endpoint: str, request: str) -> dict[str, Any]:
    """Send a request to the bridge at `endpoint` and return its answer.

    Raises `TeleopError` if there is no answer, or a refusal.
    """
    end = now_ns() + ANSWER_S * 1e9
    credentials = load_credentials(config, session, CertificateRole.SUPERVISOR)
    with open_session(credentials, [], [endpoint]) as asking:
        while now_ns() < end:
            replies: Any = asking.get(_build_control_key(session), payload=request, timeout=0.5)
            for reply in replies:
                if reply.ok is None:
                    continue
                content: dict[str, Any] = json.loads(reply.ok.payload.to_bytes())
                if "error" in content:
                    raise TeleopError(content["error"])
                answer: dict[str, Any] = content["answer"]
                return answer
    raise TeleopError(f"no answer at {endpoint} for session {session!r}")


def _build_control_key(session: str) -> str:
    return f"teleop/{session}/@impair"
