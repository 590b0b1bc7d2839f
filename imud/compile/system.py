"""System calls, and memory and functions by their address, for compiled loops. Linux; through numba on 64 bits.

All arguments are integers, addresses too. Nothing is checked: the caller is responsible for the contents at an address,
and for keeping the array there alive.
"""

from typing import Any

import numpy as np

from .jit import NumbaObject, inlined, kernel

CLOCK_REALTIME, CLOCK_MONOTONIC = 0, 1
EAGAIN = 11
_TFD_TIMER_ABSTIME = 1


def _function(name: str, returns: str, *arguments: str) -> Any:
    """A function of the C library; types as numba calls them."""

    def make(numba: Any) -> Any:
        types = numba.types
        return types.ExternalFunction(name, getattr(types, returns)(*(getattr(types, a) for a in arguments)))

    return NumbaObject(make, external=name)


carray: Any = NumbaObject(lambda numba: numba.carray, "carray")
epoll_wait: Any = _function("epoll_wait", "int32", "int32", "int64", "int32", "int32")
pwrite: Any = _function("pwrite", "int64", "int32", "int64", "int64", "int64")
read: Any = _function("read", "int64", "int32", "int64", "int64")
send: Any = _function("send", "int64", "int32", "int64", "int64", "int32")
_timerfd_settime: Any = _function("timerfd_settime", "int32", "int32", "int32", "int64", "int64")
_clock_gettime: Any = _function("clock_gettime", "int32", "int32", "int64")
_errno_location: Any = _function("__errno_location", "int64")


@kernel
def errno() -> int:
    """The error number of the last system call that failed."""
    return int(carray(pointer(_errno_location()), 1, np.int32)[0])


@kernel
def clock_ns(clock: int, scratch: int) -> int:
    """Time of a clock, ns. scratch: address of 16 bytes of scratch memory."""
    _clock_gettime(clock, scratch)
    time = carray(pointer(scratch), 2, np.int64)
    return int(time[0] * 1_000_000_000 + time[1])


@kernel
def set_timer(file: int, at_ns: int, scratch: int) -> None:
    """Have a timerfd expire once, at a time of its clock, at once if it is past. scratch: address of 32 bytes."""
    time = carray(pointer(scratch), 4, np.int64)
    time[0] = time[1] = 0  # no period
    time[2], time[3] = max(at_ns, 1) // 1_000_000_000, max(at_ns, 1) % 1_000_000_000  # 0 would disarm it
    _timerfd_settime(file, _TFD_TIMER_ABSTIME, scratch, 0)


def _pointer(numba: Any) -> Any:
    def emit(typing_context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(numba.types.voidptr))

        return numba.types.voidptr(address), generate

    return numba.extending.intrinsic(emit)


def _call(numba: Any) -> Any:
    def emit(typing_context: Any, function: Any, arguments: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            from llvmlite import ir

            address, packed = values
            long = ir.IntType(64)
            passed = [builder.extract_value(packed, i) for i in range(len(arguments))]
            kind = ir.FunctionType(long, [long] * len(passed)).as_pointer()
            return builder.call(builder.inttoptr(address, kind), passed)

        long = numba.types.int64
        return long(function, numba.types.UniTuple(long, len(arguments))), generate

    return numba.extending.intrinsic(emit)


def _fence(numba: Any) -> Any:
    def emit(typing_context: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            builder.fence("seq_cst")
            return context.get_dummy_value()

        return numba.types.none(), generate

    return numba.extending.intrinsic(emit)


pointer: Any = NumbaObject(_pointer)  # what `carray` takes
call: Any = NumbaObject(_call, "call")  # (address, (argument, ...)) -> int; of an entry whose arguments are integers
fence: Any = NumbaObject(_fence, "fence")  # () no store moves across it, in either direction: ARM would let them


@inlined
def records(address: int, n: int, dtype: Any) -> Any:
    """The n records of this type at the address."""
    return carray(pointer(address), n, dtype)


records.intrinsic = "records"  # type: ignore[attr-defined]
