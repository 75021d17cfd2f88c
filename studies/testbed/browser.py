"""A headless Chromium that is spoken to through a pipe: open a page, look at it.

The DevTools protocol over a pair of pipes needs no package and no port. Drawing is by software, so
it works where there is no graphics card; Rerun's page takes 10 to 60 s to appear.
"""

import base64
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from teleop.runtime.child_process import end_process

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-pipe",
)
_PATIENCE_S = 90.0  # [s] for an answer
_LOOK_S, _STILL = 3.0, 2  # [s] between two looks, and how many must be the same
_CHANGE, _COLOURS = 0.05, 300  # levels on average; a page that is still empty has fewer colours
Picture = NDArray[np.uint8]  # shape (height, width, 3)


def find_program() -> str | None:
    """Return a Chromium on this machine, if there is one."""
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


def has_many_colours(picture: Picture) -> bool:
    """Return whether a page is no longer empty, judged by the number of its colours."""
    return len(np.unique(picture[::4, ::4].reshape(-1, 3), axis=0)) > _COLOURS


class Browser:
    """One page of `width` by `height` pixels, in a browser that prefers a light or dark theme."""

    def __init__(self, width: int = 1280, height: int = 800, theme: str = "light") -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True)
        there, self._write = os.pipe()
        self._read, back = os.pipe()

        def wire() -> None:  # the protocol's pipes are 3 and 4 in the child
            high = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (there, back)]
            for place, end in enumerate(high, start=3):
                os.dup2(end, place)

        self._process = subprocess.Popen(
            [
                *(str(find_program()), *_FLAGS, f"--user-data-dir={self._folder.name}"),
                *(f"--window-size={width},{height}", "about:blank"),
            ],
            preexec_fn=wire,  # noqa: PLW1509 - it only moves descriptors
            pass_fds=(3, 4),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(there)
        os.close(back)
        self._buffer = b""
        self._count = 0
        self._session: str | None = None
        self._loaded = False
        self.answered: list[str] = []  # addresses
        self.complaints: list[str] = []
        targets = self.ask("Target.getTargets")["targetInfos"]
        target = next(t["targetId"] for t in targets if t["type"] == "page")
        attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime"):
            self.ask(f"{domain}.enable")
        self.emulate(width, height, theme)

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        end_process(self._process, 5.0)
        os.close(self._write)
        os.close(self._read)
        self._folder.cleanup()

    @property
    def pid(self) -> int:
        """Its process id, and that of its process group."""
        return self._process.pid

    def emulate(self, width: int, height: int, theme: str) -> None:
        """Show pages in `width` by `height` pixels, and prefer a light or dark theme."""
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        preferred = [{"name": "prefers-color-scheme", "value": theme}]
        self.ask("Emulation.setEmulatedMedia", features=preferred)

    def open(self, address: str) -> None:
        """Go to an address, and wait until the page itself is there."""
        self._loaded = False
        self.ask("Page.navigate", url=address)
        end = time.monotonic() + _PATIENCE_S
        while not self._loaded:
            self._note(self._next(end - time.monotonic()))

    def picture(self) -> Picture:
        """Return the page as it looks now."""
        data = base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def settle(
        self,
        patience_s: float,
        still: int = _STILL,
        appeared: Callable[[Picture], bool] = has_many_colours,
    ) -> Picture:
        """Wait until the page has appeared and changes no more, or for so long; return it.

        It changes no more when `still` looks in a row are the same. `appeared` tells by a picture
        whether it shows what it should; a page of few colours needs one of its own.
        """
        end = time.monotonic() + patience_s
        last, same = self.picture(), 0
        while same < still and time.monotonic() < end:
            time.sleep(_LOOK_S)
            now = self.picture()
            changed = np.abs(now.astype(int) - last).mean() > _CHANGE
            same = 0 if changed or not appeared(now) else same + 1
            last = now
        return last

    def save(self, path: Path) -> None:
        """Write the page as it looks now."""
        Image.fromarray(self.picture()).save(path, optimize=True)

    def ask(
        self, method: str, patience_s: float = _PATIENCE_S, **parameters: Any
    ) -> dict[str, Any]:
        """Send a command and return its result."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + patience_s
        while True:
            answer = self._next(end - time.monotonic())
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def _next(self, patience_s: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(0.0, patience_s))
            data = os.read(self._read, 1 << 20) if ready else b""
            if not data:
                raise TimeoutError("the browser does not answer")
            self._buffer += data
        line, self._buffer = self._buffer.split(b"\0", 1)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _note(self, event: dict[str, Any]) -> None:
        """Keep whom the page got an answer from, and what it complained about."""
        parameters = event.get("params", {})
        if event.get("method") == "Network.responseReceived":
            self.answered.append(parameters["response"]["url"])
        elif event.get("method") == "Page.loadEventFired":
            self._loaded = True
        elif event.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(parameters["exceptionDetails"].get("text", ""))
