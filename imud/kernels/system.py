"""System calls, and memory and functions by their address, for compiled loops. Linux on 64 bits.

All arguments are integers: an address is one, too. What stands at an address the caller answers for: nothing is
checked, and whoever gives an address away keeps its array alive.
"""

from collections.abc import Callable
from typing import Any

import numba
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .jit import CACHED, inlined, kernel

CLOCK_REALTIME, CLOCK_MONOTONIC = 0, 1
EAGAIN = 11
_long, _int = types.int64, types.int32
_types: Any = types
ir: Any = cgutils.ir  # type: ignore[attr-defined]
carray: Any = numba.carray  # type: ignore[attr-defined]
ppoll: Any = types.ExternalFunction("ppoll", _int(_long, _long, _long, _long))
read: Any = types.ExternalFunction("read", _long(_int, _long, _long))
send: Any = types.ExternalFunction("send", _long(_int, _long, _long, _int))
_clock_gettime: Any = types.ExternalFunction("clock_gettime", _int(_int, _long))
_errno_location: Any = types.ExternalFunction("__errno_location", _types.CPointer(_int)())


@kernel
def errno() -> int:
    """Of the last system call that failed."""
    return int(carray(_errno_location(), 1)[0])


@kernel
def clock_ns(clock: int, room: int) -> int:
    """Time of a clock, ns. room: address of 16 bytes to work in."""
    _clock_gettime(clock, room)
    time = carray(pointer(room), 2, types.int64)
    return int(time[0] * 1_000_000_000 + time[1])


def _emit_pointer(typing_context: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

    return types.voidptr(address), generate


pointer: Any = intrinsic(_emit_pointer)  # what `carray` takes


def _emit_call(typing_context: Any, function: Any, arguments: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address, packed = values
        long = ir.IntType(64)
        passed = [builder.extract_value(packed, i) for i in range(len(arguments))]
        kind = ir.FunctionType(long, [long] * len(passed)).as_pointer()
        return builder.call(builder.inttoptr(address, kind), passed)

    return types.int64(function, _types.UniTuple(types.int64, len(arguments))), generate


call: Any = intrinsic(_emit_call)  # (address, (argument, ...)) -> int; of a function that `callable_from_c` made


def callable_from_c(arguments: int) -> Callable[[Callable[..., int]], Any]:
    """Compiles, at once, a function of so many integers that returns one; `.address` of the result is for `call`."""
    signature = types.int64(*[types.int64] * arguments)
    return numba.cfunc(signature, cache=CACHED, error_model="numpy")


@inlined
def records(address: int, n: int, dtype: Any) -> Any:
    """The n records of this type that stand there."""
    return carray(pointer(address), n, dtype)
