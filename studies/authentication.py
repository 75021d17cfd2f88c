"""What authentication costs: the tags of a tick, and a session plain against authenticated.

    python -m studies.authentication             the tags, and sessions of 15 s
    python -m studies.authentication --tags      the tags only

Sessions of both kinds run in turns, twice each (`--rounds`); figures are medians of them. Takes
2 minutes.
"""

import itertools
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from studies.testbed.command import measure_us, parse_options
from studies.testbed.processes import DEMO_CONFIG, find_free_ports
from teleop.link.reception import Reception
from teleop.messages.messages import LAYOUT
from teleop.messages.topics import COMMAND, STATE, Role
from teleop.security import CertificateRole
from teleop.security.credentials import create_local_credentials
from teleop.security.handshake import Handshake
from teleop.security.keyring import Keyring
from teleop.security.presence import RoleStage, Token

CALLS, ROUNDS = 200, 300


def main() -> None:
    args = parse_options(
        __doc__,
        tags=(False, "the tags only"),
        seconds=(15.0, "of each session"),
        rounds=(2, "sessions of each kind, in turns"),
    )
    for topic, sender, receiver in (
        (COMMAND, Role.MASTER, Role.SLAVE),
        (STATE, Role.SLAVE, Role.MASTER),
    ):
        made, checked = measure_tag_us(topic, sender, receiver)
        print(f"{topic.name:8} tag made {made:5.2f} us, checked {checked:5.2f} us")
    if not args.tags:
        print_sessions(args.seconds, args.rounds)


def measure_tag_us(topic: Any, sender: Role, receiver: Role) -> tuple[float, float]:
    """Return what a tag costs its sender and its receiver [us], on top of everything else."""
    nonces = {sender: 1, receiver: 2}
    roles = {Role.MASTER: CertificateRole.MASTER, Role.SLAVE: CertificateRole.SLAVE}
    shakes = {
        role: Handshake(create_local_credentials("bench", roles[role]), "bench", nonce)
        for role, nonce in nonces.items()
    }
    rings = {role: Keyring(role, nonce) for role, nonce in nonces.items()}
    for role, other in ((sender, receiver), (receiver, sender)):
        token = shakes[other].prove(Token(other, LAYOUT, nonces[other], RoleStage.HELD))
        peer = shakes[role].check(token)
        rings[role].add(peer, shakes[role].derive_pair_keys(peer))
    data = topic.message().pack(1, 1, 1)
    ((addressee, base),) = rings[sender].find_seal_keys(topic).entries

    def seal() -> bytes:
        mac = base.copy()
        mac.update(data)
        return addressee + mac.digest()

    senders = rings[receiver].find_keys(topic)
    tagged = Reception(topic, lambda _: 1, senders, rings[receiver].addressee)
    plain = Reception(topic, lambda _: 1)
    arrived = data + seal()
    with_tag, without, made = (
        measure_us(call, CALLS, ROUNDS)
        for call in (lambda: tagged.admit(arrived), lambda: plain.admit(data), seal)
    )
    return made, with_tag - without


def print_sessions(seconds: float, rounds: int) -> None:
    """Print latency and processor time of sessions, plain and authenticated."""
    found: dict[str, list[dict[str, float]]] = {"plain": [], "authenticated": []}
    for _, kind in itertools.product(range(rounds), found):
        found[kind].append(run_session(seconds, ["--insecure"] if kind == "plain" else []))
    medians = {
        kind: {name: statistics.median(run[name] for run in runs) for name in runs[0]}
        for kind, runs in found.items()
    }
    for name in medians["plain"]:
        plain, authenticated = (medians[kind][name] for kind in found)
        ratio = authenticated / plain if plain else float("nan")
        print(f"{name:28} plain {plain:8.3f}  authenticated {authenticated:8.3f}  x {ratio:.3f}")


def run_session(seconds: float, words: list[str]) -> dict[str, float]:
    """Run a session and return its figures."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run.json"
        sides = zip(("master", "slave"), find_free_ports(2), strict=True)
        ends = [f"--set=link.{side}=127.0.0.1:{port}" for side, port in sides]
        before = read_children_s()
        subprocess.run(
            [sys.executable, "-m", "teleop", "run", "--config", str(DEMO_CONFIG), "--view", "none",
             "--duration", str(seconds), "--json", str(out), *ends, *words,
             "--set=session=authentication", "--set=master.device.engage=[[0.5, 1e6]]",
             "--set=master.device.engage_period=1e7"],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        summary = json.loads(out.read_text())
        used = read_children_s() - before
    master, slave = summary["master"], summary["slave"]
    return {
        "command to force p50 [ms]": master["latency_ms"]["p50"],
        "command to force p99 [ms]": master["latency_ms"]["p99"],
        "work of the master p50 [us]": master["work_us"]["p50"],
        "work of the slave p50 [us]": slave["work_us"]["p50"],
        "processor time, start too [s]": used,
    }


def read_children_s() -> float:
    """Return the processor time of all children that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main()
