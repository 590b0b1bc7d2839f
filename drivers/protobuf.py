"""The part of Protocol Buffers (proto3) that recordings use: encoding, decoding, and the description of messages.

https://protobuf.dev/programming-guides/encoding
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # wire types
_FIXED = {FIXED64: 8, FIXED32: 4}
# of a description: type and whether it is repeated, by the words of a .proto file
_TYPES = {
    "double": 1,
    "float": 2,
    "int64": 3,
    "int32": 5,
    "fixed32": 7,
    "string": 9,
    "message": 11,
    "bytes": 12,
    "sfixed64": 16,
}
_OPTIONAL, _REPEATED = 1, 3


def varint(value: int) -> bytes:
    """A number >= 0 in as few bytes as it needs."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def tag(number: int, wire: int) -> bytes:
    """What stands before the value of the field with that number."""
    return varint(number << 3 | wire)


def delimited(number: int, value: bytes | str) -> bytes:
    """A field of bytes: a text, a message, or numbers of fixed size one behind the other."""
    data = value.encode() if isinstance(value, str) else value
    return tag(number, BYTES) + varint(len(data)) + data


def integer(number: int, value: int) -> bytes:
    """A field int32, int64 or enum, >= 0."""
    return tag(number, VARINT) + varint(value)


def doubles(number: int, *values: float) -> bytes:
    """A field of doubles: one, or a repeated one of several."""
    data = struct.pack(f"<{len(values)}d", *values)
    return tag(number, FIXED64) + data if len(values) == 1 else delimited(number, data)


def single(number: int, value: float) -> bytes:
    """A field float, in 4 bytes."""
    return tag(number, FIXED32) + struct.pack("<f", value)


def fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Number and value of each field: an int of a varint, else the bytes. Raises ValueError where it is no message."""
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == VARINT:
            value, at = _read_varint(data, at)
            yield number, value
            continue
        size = _FIXED.get(wire)
        if size is None:
            if wire != BYTES:
                raise ValueError(f"no wire type {wire}")
            size, at = _read_varint(data, at)
        if at + size > len(data):
            raise ValueError(f"field {number} is cut off")
        yield number, data[at : at + size]
        at += size


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(data) and shift < 64:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise ValueError("a number is cut off")


@dataclass(frozen=True)
class Field:
    """One field of a message, as a .proto file has it. type: also the full name of a message; about: its comment."""

    number: int
    name: str
    type: str
    repeated: bool = False
    about: str = ""


def description(messages: Mapping[str, Sequence[Field]]) -> bytes:
    """A FileDescriptorSet that describes these messages, by their full names; those that are used come first.

    https://github.com/protocolbuffers/protobuf/blob/main/src/google/protobuf/descriptor.proto
    """
    files = []
    for i, (full_name, its_fields) in enumerate(messages.items()):
        package, _, name = full_name.rpartition(".")
        used = {field.type for field in its_fields}
        message = delimited(1, name) + b"".join(delimited(2, _described(field)) for field in its_fields)
        comments = b"".join(
            delimited(1, delimited(1, bytes((4, 0, 2, k))) + delimited(2, bytes(3)) + delimited(3, field.about))
            for k, field in enumerate(its_fields)
            if field.about
        )
        files.append(
            delimited(1, _file_name(full_name))
            + delimited(2, package)
            + b"".join(delimited(3, _file_name(other)) for other in list(messages)[:i] if other in used)
            + delimited(4, message)
            + (delimited(9, comments) if comments else b"")
            + delimited(12, "proto3")
        )
    return b"".join(delimited(1, file) for file in files)


def _described(field: Field) -> bytes:
    scalar = field.type in _TYPES
    return (
        delimited(1, field.name)
        + integer(3, field.number)
        + integer(4, _REPEATED if field.repeated else _OPTIONAL)
        + integer(5, _TYPES[field.type] if scalar else _TYPES["message"])
        + (b"" if scalar else delimited(6, f".{field.type}"))
    )


def _file_name(full_name: str) -> str:
    return full_name.replace(".", "/") + ".proto"
