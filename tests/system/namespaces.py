"""Network namespaces joined by veth cables, in which processes have addresses of their own."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import pytest

from studies.testbed.processes import OURS
from tests.root import ROOT

PREFIX = "10.71"  # of all addresses here; cable N is PREFIX.N.0/24, its ends .1 and .2


def require_namespaces() -> None:
    """Skip a test where namespaces cannot be made, with the reason."""
    if shutil.which("ip") is None:
        pytest.skip("network namespaces need iproute2 (the command ip)")
    probe = f"teleop-{os.getpid()}-probe"
    made = subprocess.run(
        ["ip", "netns", "add", probe], check=False, capture_output=True, text=True
    )
    if made.returncode:
        pytest.skip(f"no network namespace can be made here: {made.stderr.strip()} (not root?)")
    try:
        cable = ["ip", "-n", probe, "link", "add", "name", "end1"]
        cable += ["type", "veth", "peer", "name", "end2"]
        joined = subprocess.run(cable, check=False, capture_output=True, text=True)
        if joined.returncode:
            pytest.skip(f"no veth pair can be made here: {joined.stderr.strip()}")
    finally:
        _ip("netns", "delete", probe)


class Network:
    """Hosts, and cables between two of them each; removed with the context.

    Attributes
    ----------
    address : dict
        (host, other) -> address of `host` on its cable to `other`.
    """

    def __init__(self, hosts: Sequence[str], cables: Sequence[tuple[str, str]]) -> None:
        self._spaces = {host: f"teleop-{os.getpid()}-{host}" for host in hosts}
        self._cables = {cable: f"cable{number}" for number, cable in enumerate(cables, 1)}
        self.address: dict[tuple[str, str], str] = {}
        self._started: list[tuple[subprocess.Popen[bytes], BinaryIO]] = []

    def __enter__(self) -> "Network":
        try:
            for space in self._spaces.values():
                _ip("netns", "add", space)
                _ip("-n", space, "link", "set", "lo", "up")
            for number, (cable, name) in enumerate(self._cables.items(), 1):
                self._lay(number, cable, name)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for process, log in self._started:
            if process.poll() is None:
                process.kill()
            process.wait()
            log.close()
        for space in self._spaces.values():
            subprocess.run(["ip", "netns", "delete", space], check=False, capture_output=True)

    def start(self, host: str, words: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
        """Start a command on a host; it ends with the network."""
        out = log.open("wb")
        space = ["ip", "netns", "exec", self._spaces[host]]  # replaced by the command itself
        process = subprocess.Popen([*space, *words], stdout=out, stderr=out, env=OURS, cwd=ROOT)
        self._started.append((process, out))
        return process

    def plug(self, near: str, far: str, up: bool) -> None:
        """Pull the cable of two hosts at `near`, or plug it in again."""
        name = self._cables[near, far] if (near, far) in self._cables else self._cables[far, near]
        _ip("-n", self._spaces[near], "link", "set", name, "up" if up else "down")

    def _lay(self, number: int, cable: tuple[str, str], name: str) -> None:
        one, two = (self._spaces[host] for host in cable)
        pair = ["link", "add", "name", name, "netns", one, "type", "veth", "peer", "name", name]
        _ip(*pair, "netns", two)
        for end, (host, other) in enumerate((cable, cable[::-1]), 1):
            address = self.address[host, other] = f"{PREFIX}.{number}.{end}"
            _ip("-n", self._spaces[host], "address", "add", f"{address}/24", "dev", name)
            _ip("-n", self._spaces[host], "link", "set", name, "up")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)
