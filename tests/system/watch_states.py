"""Print the states of both sides as they change: `python -m tests.system.watch_states`.

Arguments: router, folder of keys, session. A process, since a host of its own is one of processes.
"""

import sys
import time
from pathlib import Path

from teleop.link import Link, LinkConfig
from teleop.messages.topics import COMMAND, STATE, Role
from teleop.session.state_machine import State


def main(router, keys, session):
    """Watch until killed."""
    config = LinkConfig(routers=(router,), keys=Path(keys))
    seen = {}
    with Link(config, session, Role.VIEWER) as link:
        while True:
            for side, topic in (("master", COMMAND), ("slave", STATE)):
                message = link.take_latest(topic).message
                if message is not None and seen.get(side) != message.state:
                    seen[side] = message.state
                    print(side, State(message.state).name.lower(), flush=True)
            time.sleep(0.01)


if __name__ == "__main__":
    main(*sys.argv[1:])
