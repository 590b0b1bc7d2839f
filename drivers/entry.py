"""Entries: the kernels that Python calls while samples come, as machine code that is loaded without numba.

numba compiles an entry once, with all that it calls, and the object file is kept in the cache directory under the
entry's name and the types of its arguments. From then on llvmlite alone loads it, in 2 ms, where importing numba and
reading its own cache takes 0.5 s. A call is cheaper, too: there is one signature, so nothing is dispatched. Only the
entry is visible in the object, so LLVM removes whatever cannot be reached; a kernel that may raise is refused.
"""

import contextlib
import ctypes
import functools
import hashlib
import importlib
import inspect
import itertools
import os
import tempfile
import weakref
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from .jit import Kernel

Function = TypeVar("Function", bound=Callable[..., Any])
Kind = np.dtype[Any] | None  # of an array's elements; None: an integer
_SYMBOL = "entry"
_number = itertools.count()  # names of libraries must differ
_noted: "dict[str, tuple[Entry, tuple[Kind, ...]]] | None" = None  # while `noting`: by symbol, what is called
_DIGEST = hashlib.sha256().digest_size


class Entry(Kernel):
    """A kernel whose arguments are integers and 1-d arrays, always of the same types. Returns an integer, or None as 0.

    Called from another kernel it is a kernel like any. Not thread-safe.
    """

    def __init__(self, function: Callable[..., Any], waits: bool = False) -> None:
        """waits: release the GIL during a call, so that other threads run meanwhile."""
        super().__init__(function)
        self._interface = ctypes.CFUNCTYPE if waits else ctypes.PYFUNCTYPE
        self._kinds: tuple[Kind, ...] = ()
        self._last: list[Callable[[], Any]] = []  # weak: an array given once must not be kept alive
        self._words: list[int] = []

    def __call__(self, *arguments: Any) -> int:
        """Raises TypeError if an argument is not of the type it was in the first call."""
        if _noted is not None:
            return self._note(arguments)
        if not self._kinds:
            self._load(arguments)
        last = self._last
        for i, argument in enumerate(arguments):
            if argument is not last[i]():
                self._take(i, argument)
        return cast(int, self._call(*self._words))

    @property
    def address(self) -> int:
        """Address of the machine code, for callers that are compiled themselves. All arguments must be integers."""
        integers = (0,) * len(inspect.signature(self.py_func).parameters)
        if _noted is not None:
            return self._note(integers)
        if not self._kinds:
            self._load(integers)
        return cast(int, self._library[_SYMBOL])

    def _note(self, arguments: tuple[Any, ...]) -> int:
        assert _noted is not None
        kinds = _kinds(arguments)
        _noted[symbol(self, kinds)] = self, kinds
        return 0

    def _load(self, arguments: tuple[Any, ...]) -> None:
        kinds = _kinds(arguments)
        sizes = [1 if kind is None else 2 for kind in kinds]
        self._library = _linked(self, kinds)
        self._call = self._interface(ctypes.c_int64, *[ctypes.c_int64] * sum(sizes))(self._library[_SYMBOL])
        self._places, self._words = [sum(sizes[:i]) for i in range(len(sizes))], [0] * sum(sizes)
        self._last, self._kinds = [_nothing] * len(kinds), kinds

    def _take(self, i: int, argument: Any) -> None:
        """Remember an argument that differs from the one in the last call."""
        kind, place = self._kinds[i], self._places[i]
        if kind is None:
            self._words[place] = argument
        elif argument.dtype == kind and argument.ndim == 1 and argument.flags.carray:
            self._words[place : place + 2] = argument.ctypes.data, len(argument)
            self._last[i] = weakref.ref(argument)
        else:
            raise TypeError(f"{self.name}: argument {i} must be a writable contiguous array of {kind}")


def _kinds(arguments: tuple[Any, ...]) -> tuple[Kind, ...]:
    return tuple(a.dtype if isinstance(a, np.ndarray) else None for a in arguments)


@contextlib.contextmanager
def noting() -> Iterator[dict[str, tuple[Entry, tuple[Kind, ...]]]]:
    """Within the block a call of an entry does nothing but note the entry, by symbol, and its arguments' types."""
    global _noted  # noqa: PLW0603
    _noted = {}
    try:
        yield _noted
    finally:
        _noted = None


def symbol(kernel: Kernel, kinds: Sequence[Kind]) -> str:
    """What an entry for arguments of these types is called in a shared library."""
    return _file_name(kernel, kinds).removesuffix(".o").replace(".", "_").replace("-", "_")


def _nothing() -> None:
    """Stands for a weak reference whose object is gone."""


def entry(function: Function) -> Function:
    """Make `function` an entry; its own type is kept for the type checker."""
    return cast(Function, Entry(function))


def waiting_entry(function: Function) -> Function:
    """An entry that releases the GIL: other threads run while it waits."""
    return cast(Function, Entry(function, waits=True))


def _linked(kernel: Kernel, kinds: Sequence[Kind]) -> Any:
    """The machine code, loaded for as long as the result is kept. Compiled if the cache does not have it."""
    cache = os.environ.get("NUMBA_CACHE_DIR")
    path = Path(cache, _file_name(kernel, kinds)) if cache else None
    code = _kept(path) if path else None
    if code is None:
        code = _compiled(kernel, kinds, path.parent if path else None)
        if path:
            _keep(path, code)
    import llvmlite.binding as llvm

    return (
        llvm.JITLibraryBuilder()
        .add_object_img(code)
        .export_symbol(_SYMBOL)
        .add_current_process()
        .link(_linker(), f"{kernel.name}-{next(_number)}")
    )


@functools.cache
def _linker() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.create_lljit_compiler()


def _file_name(kernel: Kernel, kinds: Sequence[Kind]) -> str:
    types = hashlib.sha256(repr([kind and (kind.descr, kind.itemsize) for kind in kinds]).encode())
    return f"{kernel.name}-{types.hexdigest()[:8]}.o"


def _kept(path: Path) -> bytes | None:
    """The object code, if the file is there and whole."""
    with contextlib.suppress(OSError):
        content = path.read_bytes()
        if content[:_DIGEST] == hashlib.sha256(content[_DIGEST:]).digest():
            return content[_DIGEST:]
    return None


def _keep(path: Path, code: bytes) -> None:
    """Write the whole file or nothing: other processes may read it, or write it too."""
    with contextlib.suppress(OSError):
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(hashlib.sha256(code).digest() + code)
        Path(file.name).replace(path)


def _compiled(kernel: Kernel, kinds: Sequence[Kind], cache: Path | None) -> bytes:
    """The object code. If numba fails, its own cache is emptied and it tries again: a power cut leaves empty files."""
    try:
        return _object_code(kernel, kinds)
    except Exception:
        if cache is None:
            raise
        for index in cache.glob("*/*.nbi"):
            index.unlink(missing_ok=True)
        return _object_code(kernel, kinds)


def _object_code(kernel: Kernel, kinds: Sequence[Kind]) -> bytes:
    """An object file with the one symbol `entry`: int64 (address and length of each array, each integer)."""
    import llvmlite.binding as llvm

    text, name = _intermediate_code(kernel, kinds)
    module = llvm.parse_assembly(text)
    for value in (*module.functions, *module.global_variables):
        if value.name == name:
            value.name = _SYMBOL
        elif not value.is_declaration:
            value.linkage = "internal"
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=os.environ.get("NUMBA_CPU_NAME") or llvm.get_host_cpu_name(),  # as numba chooses
        features=os.environ.get("NUMBA_CPU_FEATURES") or llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="pic",
        codemodel="small",
    )
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.slp_vectorization = True  # of neighbouring statements: most of our loops are over three axes
    passes = llvm.create_pass_builder(machine, tuning)
    passes.getModulePassManager().run(module, passes)
    if needed := [f.name for f in module.functions if f.name.startswith(("NRT_", "numba_"))]:
        raise TypeError(f"the entry {kernel.name} allocates or may raise: it needs {', '.join(needed)}")
    return cast(bytes, machine.emit_object(module))


def _intermediate_code(kernel: Kernel, kinds: Sequence[Kind]) -> tuple[str, str]:
    """LLVM's text of the kernel behind a C interface, and the name of the function that has it."""
    numba: Any = importlib.import_module("numba")
    types = numba.types
    parts = [None if kind is None else numba.from_dtype(kind) for kind in kinds]
    arguments = tuple(types.int64 if part is None else types.Array(part, 1, "C") for part in parts)
    kernel.compiled.compile(arguments)
    returns = kernel.compiled.overloads[arguments].signature.return_type is not types.none
    names = ", ".join(f"a{i}" if part is None else f"a{i}, n{i}" for i, part in enumerate(parts))
    passed = ", ".join(f"a{i}" if part is None else f"carray(a{i}, n{i})" for i, part in enumerate(parts))
    body = f"return kernel({passed})" if returns else f"kernel({passed})\n    return 0"
    scope: dict[str, Any] = {"kernel": kernel, "carray": numba.carray}
    exec(f"def interface({names}):\n    {body}", scope)
    words = [[types.int64] if part is None else [types.CPointer(part), types.int64] for part in parts]
    signature = types.int64(*(word for pair in words for word in pair))
    compiled = numba.cfunc(signature, error_model="numpy")(scope["interface"])
    return compiled.inspect_llvm(), compiled.native_name
