"""The memory image that the virtual machine boots: Python, our sources, kernel modules, no more.

Every file has the path it has here, so that Python finds its own as it does here. What is needed
is what Python has loaded once it has imported what runs in there.
"""

import json
import lzma
import os
import re
import stat
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

MODULES = "/modules"  # where the image has the kernel's modules, numbered in the order to load
_IMPORTS = """
import json, sys
from importlib import import_module
for name in sys.argv[1:]:
    import_module(name)
print(json.dumps([
    path for module in list(sys.modules.values())
    for path in (getattr(module, "__file__", None), getattr(module, "__cached__", None)) if path
]))
"""


class Archive:
    """A cpio archive in the form the kernel unpacks ("newc")."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._names: set[str] = set()

    def add(self, path: str, mode: int, data: bytes = b"", mtime: float = 0.0) -> None:
        """Add one file, link or folder, and the folders above it."""
        name = path.strip("/")
        if not name or name in self._names:
            return
        self.add(os.path.dirname(name), stat.S_IFDIR | 0o755)
        self._names.add(name)
        self._add_entry(name, mode, data, int(mtime))

    def add_file(self, path: Path) -> None:
        """Add a file of this machine, and what its links lead to, at the same place."""
        link = _find_first_link(path)
        if link is not None:
            target = os.readlink(link)
            self.add(str(link), stat.S_IFLNK | 0o777, target.encode())
            rest = path.relative_to(link)
            self.add_file(Path(os.path.normpath(link.parent / target)) / rest)
        elif path.is_file():
            known = path.stat()
            self.add(str(path), known.st_mode, path.read_bytes(), known.st_mtime)

    def pack(self) -> bytes:
        """Return the whole."""
        self._add_entry("TRAILER!!!", 0, b"", 0)
        return b"".join(self._parts)

    def _add_entry(self, name: str, mode: int, data: bytes, mtime: int) -> None:
        number = len(self._names)
        fields = (number, mode, 0, 0, 1, mtime, len(data), 0, 0, 0, 0, len(name) + 1, 0)
        head = b"070701" + "".join(f"{value:08x}" for value in fields).encode()
        for part in (head + name.encode() + b"\0", data):
            self._parts.append(part + bytes(-len(part) % 4))


def _find_first_link(path: Path) -> Path | None:
    return next((p for p in reversed((path, *path.parents)) if p.is_symlink()), None)


def build_image(main: str, modules: Iterable[str], kernel_modules: Iterable[Path]) -> bytes:
    """Return the image.

    Parameters
    ----------
    main : str
        What to run as the first process: a Python module with a function `main`.
    modules : iterable of str
        What else Python must be able to import.
    kernel_modules : iterable of Path
        In the order to load them.
    """
    archive = Archive()
    for folder in ("/proc", "/sys", "/dev", "/tmp", "/root"):  # noqa: S108 - of the machine
        archive.add(folder, stat.S_IFDIR | 0o755)
    python = Path(sys.executable)
    files = [python, python.parent.parent / "pyvenv.cfg", *_list_imported([main, *modules])]
    libraries = [path for path in files if path == python or ".so" in path.suffixes]
    for path in [*files, *_list_shared(libraries)]:
        archive.add_file(path)
    for number, path in enumerate(kernel_modules):
        data = path.read_bytes()
        if path.suffix == ".xz":
            data = lzma.decompress(data)
        archive.add(f"{MODULES}/{number:02d}-{path.name}", stat.S_IFREG | 0o644, data)
    source = Path(__file__).resolve().parents[2]
    path = f"import sys; sys.path.insert(0, {str(source)!r})"
    init = f"#!{python}\n{path}\nimport {main}\n{main}.main()\n"
    archive.add("/init", stat.S_IFREG | 0o755, init.encode())
    return archive.pack()


def _list_imported(modules: Iterable[str]) -> Iterator[Path]:
    done = subprocess.run(
        [sys.executable, "-c", _IMPORTS, *modules], stdout=subprocess.PIPE, text=True, check=True
    )
    yield from (Path(path) for path in json.loads(done.stdout.splitlines()[-1]))


def _list_shared(libraries: Iterable[Path]) -> set[Path]:
    """Return the shared libraries that binaries need, as the dynamic linker finds them."""
    done = subprocess.run(
        ["ldd", *map(str, libraries)], stdout=subprocess.PIPE, text=True, check=False
    )
    return {Path(os.path.normpath(path)) for path in re.findall(r"(/\S+) \(0x", done.stdout)}
