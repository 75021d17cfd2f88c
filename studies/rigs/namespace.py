"""A network namespace of this process's own, in which CAN runs over UDP multicast."""

import os
import subprocess
import sys

from studies.rigs.bench import BUS

GROUP = "239.74.163.2"
_INSIDE = "TELEOP_CAN_NAMESPACE"
_COMMANDS = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo"


def enter() -> None:
    """Start this command again in a namespace of its own, unless it runs in one.

    Its loopback carries multicast; nothing leaves the machine, and nothing of it comes in. It is
    gone when the command ends.
    """
    os.environ[BUS] = f"udp_multicast,{GROUP}"
    if _INSIDE in os.environ:
        return
    command = f'{_COMMANDS} && exec "$@"'
    ended = subprocess.run(
        ["unshare", "--net", "sh", "-c", command, "sh", *sys.orig_argv],
        env=os.environ | {_INSIDE: "1"},
        check=False,
    )
    sys.exit(ended.returncode)
