"""The 64 bits of a floating-point number as an integer, and back, in kernels and in Python."""

import struct
from collections.abc import Callable
from typing import Any, cast

from .jit import NumbaObject


def _bitcast(numba: Any, from_type: str, to_type: str) -> Any:
    def emit(typing_context: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.bitcast(arguments[0], context.get_value_type(signature.return_type))

        return getattr(numba.types, to_type)(getattr(numba.types, from_type)), generate

    return numba.extending.intrinsic(emit)


def _to_integer(value: float) -> int:
    return int(struct.unpack("<q", struct.pack("<d", value))[0])


def _to_float(bits: int) -> float:
    return float(struct.unpack("<d", struct.pack("<q", bits))[0])


def _made(to: str, of: str, name: str, python: Callable[[Any], Any]) -> NumbaObject:
    return NumbaObject(lambda numba: _bitcast(numba, of, to), name, python=python)


float_bits = cast(Callable[[float], int], _made("int64", "float64", "float_bits", _to_integer))
float_of_bits = cast(Callable[[int], float], _made("float64", "int64", "float_of_bits", _to_float))
