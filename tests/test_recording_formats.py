"""The formats of recordings: values come back with the same bits, older versions are read, others know the schemas."""

import base64
import contextlib
import json
import math
import zlib
from pathlib import Path

import foxglove.messages
import numpy as np
import pytest
import zstandard
from google.protobuf import descriptor_pb2
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from recorded import decoded, stored

from imud.drivers.capture import Capture
from imud.drivers.capture_messages import FORMAT, READS_FIELDS, Raw, Reads
from imud.estimators.filter_states import FILTER_STATES
from imud.estimators.filter_states import STATES as FILTERED
from imud.filter_state_names import COVARIANCES
from imud.firmware_sim import recorded_bytes
from imud.recording.messages import FIX_TABLE, SCHEMAS, TABLES
from imud.recording.state_messages import STATES_FIELDS, states_message, states_rows

OLD = Path(__file__).parent / "corpus/recordings/json.mcap"
NUMBERS = 2 * len(FILTERED)
FORMAT_2 = OLD.with_name("format2.mcap")  # of an emulated M-G350 with a receiver


@pytest.mark.thorough
@given(st.data())
def test_records_come_back_with_the_same_bits(data):
    for table in TABLES:
        rows = np.zeros(3, table.dtype)
        for name in table.names:
            kind = table.dtype[name]
            if kind.base.kind == "i":
                rows[name] = data.draw(st.integers(-(2**62) + 1, 2**62 - 1))
            else:
                rows[name] = data.draw(st.one_of(st.just(np.nan), st.floats(allow_nan=False, allow_infinity=False)))
        messages = table.encode(rows)
        assert table.decode(messages).tobytes() == rows.tobytes()
        for message, wanted in zip(messages, table.objects(rows), strict=True):
            read = decoded(table.schema.name, table.schema.data, message)
            np.testing.assert_equal({name: _plain(getattr(read, name)) for name in wanted}, wanted)


@pytest.mark.thorough
@given(
    st.lists(st.none() | st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=NUMBERS, max_size=NUMBERS)
)
def test_states_come_back_and_one_that_is_not_known_costs_no_byte(numbers):
    numbers = [math.nan if number is None else number for number in numbers]
    rows = np.zeros(2, FILTER_STATES)
    rows["t_ns"], rows["covariance"] = (-5, 2**60), math.nan
    rows["covariance"][1] = np.arange(len(COVARIANCES))
    rows["value"], rows["sigma"] = numbers[: len(FILTERED)], numbers[len(FILTERED) :]
    messages = [states_message(row) for row in rows]
    assert states_rows(messages).tobytes() == rows.tobytes()
    known = np.count_nonzero(np.isfinite(numbers))
    assert 9 + 5 * known <= len(messages[0]) <= 9 + 6 * known
    read = decoded("imud.v1.States", SCHEMAS["/states"].data, messages[1])
    assert (read.t_ns, list(read.covariance)) == (2**60, list(range(len(COVARIANCES))))
    for i, state in enumerate(FILTERED):
        name = f"{state.name}_{state.unit}".rstrip("_")
        for field, number in ((name, rows["value"][1, i]), (f"sigma_{name}", rows["sigma"][1, i])):
            assert getattr(read, field) == (0.0 if math.isnan(number) else number)


@pytest.mark.parametrize(
    "data", [b"\x08\x05", b"\x09\x01", b"\x0a\x03abc", b"\x12\x03abc", b"\x12\x04abcd", b"\x19\x01\x02", b"\x1a\x00"]
)
def test_a_message_that_is_none_of_states_is_refused(data):
    with pytest.raises(ValueError, match=r"cut off|no imud|size|unpack"):
        states_rows([data])


def test_numbers_that_have_no_place_are_left_out():
    row = np.zeros(1, FILTER_STATES)
    row["value"], row["sigma"] = 1e300, -np.inf
    assert len(states_message(row[0])) == 9 + 3 + 4 * len(COVARIANCES)
    unknown_field = b"\x05\x00\x00\x80\x3f"
    assert not states_rows([unknown_field + states_message(row[0])])["covariance"].any()


def fields_of(descriptions):
    """Names and numbers of the fields of each message in a FileDescriptorSet."""
    messages = [m for file in descriptor_pb2.FileDescriptorSet.FromString(descriptions).file for m in file.message_type]
    return {message.name: {field.name: field.number for field in message.field} for message in messages}


def test_the_schemas_are_those_that_foxglove_knows():
    for topic, name in (("/location", "LocationFix"), ("/tf", "FrameTransform")):
        theirs = fields_of(getattr(foxglove.messages, name).get_schema().data)
        for message, fields in fields_of(SCHEMAS[topic].data).items():
            assert fields.items() <= theirs[message].items()


def test_the_layouts_are_those_of_their_version():
    """A table whose fields change needs another FORMAT, and a decoder of this one: there are recordings of it."""
    assert FORMAT == 3
    assert [(f.number, f.name, f.type, f.repeated) for f in READS_FIELDS] == [
        (1, "port", "bytes", False),
        (3, "size", "fixed32", True),
        (5, "pulse_ns", "sfixed64", True),
        (6, "elapsed_ns", "bytes", False),
        (7, "width", "fixed32", True),
        (8, "data", "bytes", False),
    ]
    layouts = {
        table.name: zlib.crc32(" ".join(f"{f.number} {f.name} {f.type} {f.repeated}" for f in table.fields).encode())
        for table in TABLES
    }
    assert layouts == {
        "Sample": 483166579,
        "Estimate": 2117145648,
        "Fix": 4202061429,
        "Innovation": 3849674721,
        "Clock": 1622399570,
    }
    states = zlib.crc32(" ".join(f"{f.number} {f.name} {f.type}" for f in STATES_FIELDS[:72]).encode())
    assert states == 986837449  # a new one is appended


READS = st.lists(
    st.tuples(
        st.integers(0, 3),
        st.builds(
            Raw,
            st.integers(-(2**62) + 1, 2**62 - 1),
            st.binary(max_size=90) | st.integers(0, 9).map(lambda n: bytes(range(22)) * n),
            st.none() | st.integers(1, 2**62),
        ),
    ),
    max_size=30,
)


@given(READS)
def test_reads_come_back_as_they_were(reads):
    message = Reads.of(reads).encode()
    assert list(Reads.decode(message)) == reads
    emulators = [(port, raw.t_ns, raw.data) for port, raw in reads]
    assert list(recorded_bytes._reads(message)) == emulators


@given(READS, st.data())
def test_what_is_no_message_of_reads_is_refused(reads, data):
    """It is read, or a ValueError; nothing else happens, and no more memory is asked for than there are bytes."""
    message = bytearray(Reads.of(reads).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(ValueError):
        Reads.decode(bytes(message))


def test_reads_of_version_2_are_read_and_take_more_room():
    """By the descriptions in the file, as another reader sees them."""
    found, before, now = [], 0, 0
    with FORMAT_2.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.topic == "/raw":
                said, at = decoded(schema.name, schema.data, message.data), 0
                for port, t_ns, size in zip(said.port, said.t_ns, said.size, strict=True):
                    found.append((port, t_ns, said.data[at : at + size]))
                    at += size
                before += len(zstandard.compress(message.data))
                now += len(zstandard.compress(Reads.decode(message.data).encode()))
                assert list(recorded_bytes._reads(message.data)) == found[-len(said.port) :]
    assert [(port, raw.t_ns, raw.data) for entry in Capture(FORMAT_2) for port, raw in entry.reads() or ()] == found
    assert len(found) > 4000 and now < 0.65 * before


def test_a_recording_before_version_2_is_read():
    """Its JSON as another reader sees it: the reads, and the rows of all tables."""
    with OLD.open("rb") as file:
        messages = make_reader(file).iter_messages(log_time_order=False)
        said = [(channel.topic, json.loads(message.data)) for _, channel, message in messages]
    raws = [(int(topic[5:]), entry) for topic, entry in said if topic.startswith("/raw/")]
    wanted = [(port, entry["t_ns"], base64.b64decode(entry["data"])) for port, entry in raws]
    assert [(port, raw.t_ns, raw.data) for entry in Capture(OLD) for port, raw in entry.reads() or ()] == wanted
    assert len(wanted) > 900
    for table in TABLES:
        rows = stored(OLD, table)
        objects = [m for topic, m in said if topic == table.topic]
        assert len(rows) == len(objects) > 0
        for row, entry in zip(table.objects(rows), objects, strict=True):
            np.testing.assert_equal(row, {name: _plain(entry[name]) for name in row})
    with pytest.raises(ValueError, match=r"the schema imud\.v9\.Fix on /gnss/fixes is not known"):
        FIX_TABLE.read("imud.v9.Fix", [b""])


def _plain(value):
    """Lists of numbers; null is NaN."""
    if isinstance(value, int | float):
        return value
    return math.nan if value is None else [_plain(number) for number in value]
