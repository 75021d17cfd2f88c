"""Compiled functions on disk: a file each, named by a hash of all that its code depends on.

The hash is of the function's own byte code, of the constants that it names and, in turn, of the
functions that it calls, in whichever file they are. So a change of one function is a change of all
that call it, and of nothing else.
"""

import enum
import fcntl
import os
import pickle
import shutil
import sys
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import IO, Any

import llvmlite
import numba
import numpy as np
from numba.core import serialize, types
from numba.core.compiler import CompileResult

KEPT_S = 30 * 86_400.0  # [s] since its last use, after which a file is deleted
CLAIM_S = 120.0  # [s] to wait for another process that compiles the same version
_TOUCHED_S = 86_400.0  # [s] by which the noted time of the last use may be wrong
_VERSIONS = (sys.implementation.cache_tag, numba.__version__, llvmlite.__version__, np.__version__)

_salt = sha256(repr(_VERSIONS).encode())
for _file in (Path(__file__), Path(__file__).with_name("compiled.py")):
    _salt.update(_file.read_bytes())
_fingerprints: dict[FunctionType, str] = {}


def compute_fingerprint(function: FunctionType) -> str:
    """Return a hash of a function and of all that it names: callees, constants, records."""
    if function not in _fingerprints:
        _fingerprints[function] = function.__qualname__  # where it calls itself
        _fingerprints[function] = sha256(repr(_describe_function(function)).encode()).hexdigest()
    return _fingerprints[function]


def _describe_function(function: FunctionType) -> Any:
    names = _list_names(function.__code__)
    closure = [cell.cell_contents for cell in function.__closure__ or ()]
    return (
        function.__module__,  # its symbols are named by it
        function.__qualname__,
        _describe_code(function.__code__),
        [_describe_value(value, names) for value in (function.__defaults__, closure)],
        [
            (name, _describe_value(function.__globals__[name], names))
            for name in sorted(names & function.__globals__.keys())
        ],
    )


def _list_names(code: CodeType) -> set[str]:
    """Return the names of globals and attributes that code uses."""
    nested = [_list_names(const) for const in code.co_consts if isinstance(const, CodeType)]
    return set(code.co_names).union(*nested)


def _describe_code(code: CodeType) -> Any:
    consts = [
        _describe_code(const) if isinstance(const, CodeType) else _describe_value(const, set())
        for const in code.co_consts
    ]
    return code.co_code, consts, code.co_names, code.co_varnames, code.co_exceptiontable


def _describe_value(value: Any, names: set[str]) -> Any:
    """Return what stands for a value in a hash; `names` are the attributes in use of a module."""
    if hasattr(value, "py_func"):
        return _describe_value(value.py_func, names), sorted(value.targetoptions.items(), key=str)
    if isinstance(value, FunctionType):
        # of other packages, whose versions are hashed, the name is enough
        is_own = value.__module__.partition(".")[0] not in _FOREIGN
        return compute_fingerprint(value) if is_own else (value.__module__, value.__qualname__)
    if isinstance(value, ModuleType):
        if value.__name__.partition(".")[0] in _FOREIGN:
            return value.__name__
        used = sorted(names & vars(value).keys())
        return [(name, _describe_value(vars(value)[name], names)) for name in used]
    if isinstance(value, tuple | list):
        return type(value).__name__, [_describe_value(item, names) for item in value]
    if isinstance(value, frozenset):
        return sorted(map(repr, value))
    if isinstance(value, np.ndarray):
        return repr(value.dtype), value.shape, value.tobytes()
    if isinstance(value, type):
        members = [(m.name, m.value) for m in value] if issubclass(value, enum.Enum) else None
        return value.__module__, value.__qualname__, members, getattr(value, "_fields", None)
    text = repr(value)  # numba has no constants of what shows its address
    return type(value).__qualname__, "" if " at 0x" in text else text


def _describe_types(signature: Any) -> Any:
    """Return what stands for argument types: the names of a tuple's fields are not in its own."""
    named = [item for item in signature if isinstance(item, types.BaseNamedTuple)]
    fields = [item.fields for item in named]  # type: ignore[attr-defined]
    nested = [_describe_types(item) for item in signature if isinstance(item, types.BaseTuple)]
    return repr(tuple(signature)), fields, nested


_FOREIGN = frozenset(sys.stdlib_module_names) | {"numpy", "numba", "scipy"}


class FunctionCache:
    """What a numba dispatcher asks for versions of one function that were compiled before."""

    _is_pruned = False  # whether this process has deleted old files

    def __init__(self, function: FunctionType, folder: Path) -> None:
        self._function, self.cache_path = function, folder
        self._claims: dict[Path, IO[bytes]] = {}  # of what this process compiles

    def load_overload(self, signature: Any, target: Any) -> CompileResult | None:
        """Return the version for argument types, or None: then this process compiles it."""
        path = self._name_file(signature, target)
        payload = _load(path)
        if payload is None:
            self._release(path)  # of an attempt that failed
            with suppress(OSError):  # a folder that cannot be written
                self._claims[path] = _claim(path)
            payload = _load(path)
            if payload is None:
                return None
            self._release(path)
        target.refresh()
        return self._rebuild(target, payload)

    def save_overload(self, signature: Any, result: CompileResult) -> None:
        """Write a version that was compiled."""
        path = self._name_file(signature, result.target_context)
        if not result.library.has_dynamic_globals:  # addresses of this process
            data = serialize.dumps(self._reduce(result))
            part = path.with_suffix(f".{os.getpid()}")
            with suppress(OSError):  # a full disk: the next start compiles again
                part.write_bytes(data)
                part.replace(path)
        self._release(path)
        if not FunctionCache._is_pruned:
            FunctionCache._is_pruned = True
            prune(self.cache_path)

    def release_claims(self) -> None:
        """Let other processes compile what this one could not."""
        for path in list(self._claims):
            self._release(path)

    def flush(self) -> None:
        """Do nothing: what is outdated is never found."""

    def _name_file(self, signature: Any, target: Any) -> Path:
        key = _salt.copy()
        words = (type(self), compute_fingerprint(self._function), _describe_types(signature))
        key.update(repr((*words, target.codegen().magic_tuple())).encode())
        return self.cache_path / f"{self._function.__name__}-{key.hexdigest()[:24]}"

    def _release(self, path: Path) -> None:
        if claim := self._claims.pop(path, None):
            with suppress(OSError):
                os.unlink(claim.name)
            claim.close()

    def _reduce(self, result: CompileResult) -> Any:
        return result._reduce()

    def _rebuild(self, target: Any, payload: Any) -> CompileResult:
        return CompileResult._rebuild(target, *payload)


def _load(path: Path) -> Any:
    try:
        with path.open("rb") as file:
            payload = pickle.load(file)  # noqa: S301 - of a folder that nobody else can write
            is_old = time.time() - os.fstat(file.fileno()).st_mtime > _TOUCHED_S
    except (OSError, EOFError, pickle.UnpicklingError, ImportError, AttributeError):
        return None  # damaged, or of a type that has moved: it is compiled again
    if is_old:
        with suppress(OSError):
            os.utime(path)
    return payload


def _claim(path: Path) -> IO[bytes]:
    """Return a lock on what is to be compiled, once the process that holds it has ended that.

    A caller is locked before its callees, so nobody waits in a circle. Who waits for `CLAIM_S`,
    as for a suspended process, goes on without a lock.
    """
    file = path.with_suffix(".lock").open("wb")
    end = time.monotonic() + CLAIM_S
    while time.monotonic() < end:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(0.02)
        else:
            break
    return file


def prune(folder: Path) -> None:
    """Delete what no process has used for `KEPT_S`, folders of earlier versions included."""
    oldest = time.time() - KEPT_S
    for path in folder.iterdir():
        with suppress(OSError):
            if path.stat().st_mtime < oldest:
                path.unlink() if path.is_file() else shutil.rmtree(path)
