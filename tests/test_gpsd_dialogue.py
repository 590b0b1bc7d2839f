"""The language of gpsd's clients: requests, what is refused, what is chosen."""

import json

import pytest
from gpsd_loop import noise
from gpsd_synthetic import view
from hypothesis import given
from hypothesis import strategies as st

from imud.outputs.gpsd_dialogue import Policy, ReceiveBuffer, answer, devices_object, watch_object
from imud.outputs.gpsd_json import DEFAULT_CLASSES, Report
from imud.outputs.view import Device, View


def requests_of(*chunks: bytes) -> list:
    receive_buffer, found = ReceiveBuffer(), []
    for chunk in chunks:
        receive_buffer.feed(chunk)
        while request := receive_buffer.next_request():
            found.append(request)
    return found


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"?VERSION;", [("VERSION", None)]),
        (b"?VERSION\n", [("VERSION", None)]),
        (b"?DEVICES;\r\n", [("DEVICES", None)]),
        (b"?POLL;?VERSION;\n", [("POLL", None), ("VERSION", None)]),
        (b'?WATCH={"enable":true,"json":true};', [("WATCH", b'{"enable":true,"json":true}')]),
        (b'?WATCH={"raw":2,"pps":true}\r\n', [("WATCH", b'{"raw":2,"pps":true}')]),
        (b"hello\n?POLL\n", [("POLL", None)]),
        (b" \n ;; ?POLL ;", [("POLL", None)]),
        (b"?POLL", []),
        (b"?\n", [("", None)]),
        (b"?DEVICE=;", [("DEVICE", b"")]),
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", []),
    ],
)
def test_requests_are_split_into_command_and_argument(data, expected):
    assert [(request.command, request.argument) for request in requests_of(data)] == expected


@given(noise, st.data())
def test_any_chunking_gives_the_same_requests(data, draw):
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(data)), max_size=10)))
    chunks = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
    assert requests_of(*chunks) == requests_of(data)


@given(noise | st.binary(max_size=2000))
def test_no_bytes_raise_and_every_answer_is_json(data):
    policy, report = Policy(10.0), Report(view(1.0, 1.0, 1))
    for request in requests_of(data):
        answered = answer(request, policy, report)
        policy = answered.policy
        for text in answered.objects:
            message = json.loads(text)
            assert message["class"] in {"VERSION", "DEVICES", "DEVICE", "WATCH", "POLL", "ERROR"}
            assert answered.refused == (message["class"] == "ERROR")
            assert len(message.get("message", "")) < 256


@pytest.mark.parametrize(
    "argument", [b"[" * 900, b'{"a":' * 180, b'{"enable":"\xff"}', b'{"rate":1e999}', b"\x00", b'"']
)
def test_hostile_arguments_are_refused(argument):
    (request,) = requests_of(b"?WATCH=" + argument + b"\n")
    assert answer(request, Policy(10.0), Report(View())).refused


def watched(*arguments: bytes) -> Policy:
    policy = Policy(10.0)
    for argument in arguments:
        policy = policy.updated(argument)
    return policy


@pytest.mark.parametrize(
    ("arguments", "streaming"),
    [
        ([b"{}"], False),
        ([b'{"enable":true}'], False),
        ([b'{"json":true}'], True),
        ([b'{"enable":true,"json":true}'], True),
        ([b'{"raw":2,"pps":true}'], True),  # gpsmon
        ([b'{"raw":2}', b'{"raw":0}'], False),
        ([b'{"json":true}', b'{"enable":false}'], False),
        ([b'{"json":true}', b'{"enable":false}', b"{}"], True),  # json is remembered, enable means true
        ([b'{"json":true}', b'{"json":false}'], False),
        ([b'{"class":"WATCH","json":true,"scaled":true,"unknown":[1,{"a":2}]}'], True),
    ],
)
def test_watch_merges_like_gpsd(arguments, streaming):
    assert watched(*arguments).streaming == streaming


@pytest.mark.parametrize(
    ("raw", "understood"), [("true", 1), ("false", 0), ("0", 0), ("1", 1), ("2", 2), ("3", 2), ("2147483647", 2)]
)
def test_raw_is_a_number_or_a_truth_value_and_costs_no_other_key(raw, understood):
    policy = watched(b'{"json":true,"raw":%s}' % raw.encode())
    watch = json.loads(watch_object(policy))
    assert (watch["json"], watch["raw"]) == (True, understood)
    assert isinstance(watch["raw"], int) and not isinstance(watch["raw"], bool)


@pytest.mark.parametrize(
    ("argument", "classes", "rate_hz"),
    [
        (b"{}", DEFAULT_CLASSES, 10.0),
        (b'{"class":"att, tpv"}', ("TPV", "ATT"), 10.0),
        (b'{"class":"WATCH","rate":50}', DEFAULT_CLASSES, 50.0),
        (b'{"class":"EST","rate":0.5}', ("EST",), 0.5),
    ],
)
def test_watch_chooses_classes_and_rate(argument, classes, rate_hz):
    policy = watched(argument)
    assert (policy.classes, policy.rate_hz) == (classes, rate_hz)


def test_at_most_four_devices_are_listed_because_libgps_would_hang():
    devices = [Device(f"/dev/ttyUSB{n}" + "x" * 200, "driver" * 20) for n in range(5)]
    entries = json.loads(devices_object(devices))["devices"]
    assert [entry["path"][:12] for entry in entries] == [f"/dev/ttyUSB{n}" for n in range(4)]
    assert all(len(entry["path"]) == 127 and len(entry["driver"]) == 63 for entry in entries)
