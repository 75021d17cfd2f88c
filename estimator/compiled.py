"""One typed decorator for everything that is compiled, so that types survive it.

Some code is written for the compiler or for the type checker, here and in the loops:

* `fields: Any = record`: type checkers know the items of a record's array as read-only, or a
  record as an array of them; compiled code writes to them.
* `if with_dynamics is None`: numba omits a branch on an argument that is None.

Of what is called by compiled code only, no machine code is made, and nothing that Python could
call: it becomes a part of its callers. That, and less bookkeeping, shortens a first start.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, ParamSpec, TypeVar, cast

from estimator import compile_cache

_folder = compile_cache.choose_folder()  # numba reads it from the environment when it is imported

import llvmlite.binding as llvm  # noqa: E402
import numba  # noqa: E402
from numba.core import types  # noqa: E402
from numba.core.codegen import JITCodeLibrary  # noqa: E402
from numba.core.compiler import Compiler, CompileResult, compile_result  # noqa: E402
from numba.core.registry import CPUDispatcher  # noqa: E402
from numba.extending import lower_cast, overload  # noqa: E402
from numba.np import arrayobj  # noqa: E402

from estimator.function_cache import FunctionCache  # noqa: E402

if _folder is not None:
    # somebody else may have imported it before
    numba.config.CACHE_DIR = str(_folder)  # type: ignore[attr-defined]
# numba would time each of the thousands of calls to LLVM for every function being compiled
with suppress(AttributeError):  # a llvmlite that keeps this elsewhere is only slower
    llvm.ffi.lib._lock._cblist.clear()

P = ParamSpec("P")
R = TypeVar("R")


def _refuse_shape(_source: Any, _target: Any) -> None:
    """Stand for `_raise_constant` in compiled code, which alone is called."""


@overload(_refuse_shape)
def _raise_constant(_source: Any, _target: Any) -> Callable[[Any, Any], None]:
    def raise_error(_source: Any, _target: Any) -> None:
        raise ValueError("an array is assigned to a slice of another shape")

    return raise_error


# numba would compile, in every process, what formats both shapes: some 20 functions of strings
arrayobj.raise_with_shape_context = _refuse_shape

# Without the entry for calls from C, which nobody makes: a sixth of the time that compiling takes.
_OPTIONS: dict[str, Any] = {
    "nopython": True,
    "nogil": True,
    "no_cfunc_wrapper": True,
    "boundscheck": None,
}


def jit_compile(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba: IEEE arithmetic, no GIL, cached on disk where that is safe."""
    return cast(Callable[P, R], EntryDispatcher(function))


def jit_borrow(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as `jit_compile` does, but let it count no references to arrays.

    It must neither make arrays nor return any. Counting takes atomic instructions, in a step of
    some dozen small arrays a third of its time.
    """
    return cast(Callable[P, R], _BorrowingEntry(function))


def jit_inline(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as a part of the one compiled function that calls it.

    For large functions that a caller is divided into: compiled apart, they would be optimised once
    for themselves and once more within their caller. Elsewhere they are `jit_compile`.
    """
    return cast(Callable[P, R], numba.jit(function, inline="always", **_OPTIONS))


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """The code of a function that Python calls."""

    def _optimize_functions(self, ll_module: Any) -> None:
        """Do as numba does, but not for the many functions that are only declared."""
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                passes, builder = self._codegen._function_pass_manager()
                passes.run(function, builder)


class _PartLibrary(_Library):
    """The code of a function that compiled functions call: linked to theirs, never loaded."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _EntryPipeline(Compiler):  # type: ignore[misc]
    library = _Library

    def compile_extra(self, func: Any) -> Any:
        codegen = self.state.targetctx.codegen()
        self.state.library = self.library(codegen, func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class _PartPipeline(_EntryPipeline):
    library = _PartLibrary

    def compile_extra(self, func: Any) -> Any:
        self.state.flags.no_compile = True
        return super().compile_extra(func)


class _PartCache(FunctionCache):
    """The same for code that is only linked to that of callers."""

    def _reduce(self, result: CompileResult) -> Any:
        result.fndesc.typemap = result.fndesc.calltypes = None
        return (
            result.library._get_module_for_linking().as_bitcode(),
            result.fndesc,
            result.environment,
            result.signature,
            tuple(result._find_referenced_environments()),
        )

    def _rebuild(self, target: Any, payload: Any) -> CompileResult:
        bitcode, fndesc, environment, signature, environments = payload
        library = _PartLibrary(target.codegen(), fndesc.qualname)
        library._final_module = library._shared_module = llvm.parse_bitcode(bitcode)
        library._finalized = True
        return compile_result(
            typing_context=target.typing_context,
            target_context=target,
            entry_point=object(),  # by which numba looks it up
            fndesc=fndesc,
            library=library,
            signature=signature,
            objectmode=False,
            environment=environment,
            lifted=(),
            reload_init=(),
            referenced_envs=environments,  # kept for the callers
        )


class _Dispatcher(CPUDispatcher):  # type: ignore[misc]
    options, pipeline, cache = _OPTIONS, Compiler, FunctionCache

    def __init__(self, py_func: Any, *_: Any) -> None:
        super().__init__(py_func, None, self.options, self.pipeline)
        if _folder is not None:
            self._cache = self.cache(py_func, _folder)

    def compile(self, sig: Any) -> Any:
        try:
            return super().compile(sig)
        except Exception:
            if _folder is not None:
                self._cache.release_claims()
            raise


class _PartDispatcher(_Dispatcher):
    """A function as others call it when they are compiled."""

    options, pipeline = _OPTIONS | {"no_cpython_wrapper": True}, _PartPipeline
    cache = _PartCache

    def get_call_template(self, args: Any, kws: Any) -> Any:
        keywords = {name: _to_common_type(argument) for name, argument in kws.items()}
        return super().get_call_template(tuple(map(_to_common_type, args)), keywords)

    def add_overload(self, cres: CompileResult) -> None:
        if cres.entry_point is None:  # just compiled; numba looks code up by its entry point
            cres = cres._replace(entry_point=object())
            self.targetctx.insert_user_function(cres.entry_point, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = cres


class EntryDispatcher(_Dispatcher):
    """A function as Python calls it; `part` is what compiled functions call."""

    pipeline = _EntryPipeline
    part_type = _PartDispatcher

    def __init__(self, py_func: Any, *_: Any) -> None:
        super().__init__(py_func)
        self.part = self.part_type(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        return self.part._type

    def add_overload(self, cres: CompileResult) -> None:
        """Have what its parts name by address at hand, such as the values of an error."""
        for environment in cres._find_referenced_environments():
            cres.codegen.set_env(environment.env_name, environment)
        super().add_overload(cres)


class _BorrowingPart(_PartDispatcher):
    options = _PartDispatcher.options | {"_nrt": False}


class _BorrowingEntry(EntryDispatcher):
    options, part_type = EntryDispatcher.options | {"_nrt": False}, _BorrowingPart


def _to_common_type(argument: Any) -> Any:
    """Return the type that compiled callers give an argument, so that one version serves them all.

    An array within a record is an array like any other, and a literal is a number: numba would
    compile a function, and all that it calls, once more for each.
    """
    if isinstance(argument, types.NestedArray):
        return types.Array(argument.dtype, argument.ndim, "C")
    return types.unliteral(argument)  # type: ignore[no-untyped-call]


@lower_cast(types.NestedArray, types.Array)  # type: ignore[no-untyped-call, untyped-decorator]
def _cast_nested_array(_context: Any, _builder: Any, _from: Any, _to: Any, value: R) -> R:
    return value
