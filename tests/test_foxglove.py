"""`imud foxglove`: its protocol as a client of another library (aiohttp) sees it, fed by a real daemon.

Oracle of the contents: the daemon's states as `imud.client` reads them from the same stream.
"""

import asyncio
import base64
import contextlib
import math
import struct
import subprocess
import time

import numpy as np
import pytest

aiohttp = pytest.importorskip("aiohttp")
pytest.importorskip("foxglove", reason="it needs the extra imud[foxglove]")

from processes import TIMEOUT_S, daemon, process  # noqa: E402
from recorded import decoded  # noqa: E402

from imud import client  # noqa: E402
from imud.commands.live import Decimator, fix_of, solution_of  # noqa: E402
from imud.estimators.records import FIX, SOLUTION  # noqa: E402
from imud.recording.messages import SCHEMAS  # noqa: E402

MESSAGE = struct.Struct("<BIQ")  # opcode 1, subscription, log time in ns


def server(*arguments, **options):
    return process("imud", "foxglove", *map(str, arguments), stdout=subprocess.PIPE, **options)


class Viewer:
    """A client of the protocol `foxglove.sdk.v1`."""

    def __init__(self, socket):
        self._socket = socket
        self.channels = {}

    async def begin(self):
        info = await self._socket.receive_json(timeout=TIMEOUT_S)
        assert (info["op"], info["name"]) == ("serverInfo", "imud")
        while not self.channels:
            message = await self._socket.receive_json(timeout=TIMEOUT_S)
            if message["op"] == "advertise":
                self.channels = {channel["topic"]: channel for channel in message["channels"]}

    async def subscribe(self, *topics):
        wanted = [{"id": 7 + k, "channelId": self.channels[topic]["id"]} for k, topic in enumerate(topics)]
        self._topics = {7 + k: topic for k, topic in enumerate(topics)}
        await self._socket.send_json({"op": "subscribe", "subscriptions": wanted})

    async def messages(self, seconds=TIMEOUT_S):
        """Topic, log time and content of each message; ends with the time or the connection."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                async for message in self._socket:
                    if message.type == aiohttp.WSMsgType.BINARY:
                        opcode, subscription, log_ns = MESSAGE.unpack_from(message.data)
                        assert opcode == 1
                        topic = self._topics[subscription]
                        yield topic, log_ns, self._content(topic, message.data[MESSAGE.size :])

    def _content(self, topic, data):
        """Its fields by name; those that have fields themselves are messages."""
        channel = self.channels[topic]
        message = decoded(channel["schemaName"], base64.b64decode(channel["schema"]), data)
        values = {field.name: getattr(message, field.name) for field in message.DESCRIPTOR.fields}
        return {
            name: value if isinstance(value, int | float | str) or hasattr(value, "DESCRIPTOR") else list(value)
            for name, value in values.items()
        }


@contextlib.asynccontextmanager
async def viewer(url):
    async with aiohttp.ClientSession() as session, session.ws_connect(url, protocols=["foxglove.sdk.v1"]) as socket:
        assert socket.protocol == "foxglove.sdk.v1"
        one = Viewer(socket)
        await one.begin()
        yield one


@pytest.mark.thorough
def test_what_a_viewer_gets_are_the_daemons_states(tmp_path):
    stream, gpsd = tmp_path / "imud.stream", tmp_path / "gpsd.sock"
    settings = ("--set", f"stream.listen={stream}")

    async def watch(url, own):
        async with viewer(url) as one:
            assert {topic: channel["schemaName"] for topic, channel in one.channels.items()} == {
                **{"/estimate": "imud.v2.Estimate", "/gnss/fixes": "imud.v2.Fix", "/tf": "foxglove.FrameTransform"},
                **{"/location": "foxglove.LocationFix", "/gnss/location": "foxglove.LocationFix"},
            }
            for channel in one.channels.values():
                assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
                assert base64.b64decode(channel["schema"]) == SCHEMAS[channel["topic"]].data
            await one.subscribe(*one.channels)
            got = {topic: [] for topic in one.channels}
            states = {}
            async for topic, log_ns, content in one.messages():
                got[topic].append((log_ns, content))
                for state in map(client.decode, drained(own)):
                    states[state.t_ns] = state
                if min(len(got[topic]) for topic in got) >= 3:
                    return got, states
        raise AssertionError({topic: len(entries) for topic, entries in got.items()})

    with daemon(tmp_path, "--port", "sim:car", "--port", "sim:car:nmea", *settings) as imud:
        imud.until(lambda message: message["class"] == "EST" and "position" in message["state"])
        own = client.connect(stream)
        with server(stream, "--gpsd", gpsd, "--listen", "127.0.0.1:0") as running:
            got, states = asyncio.run(watch(running.stdout.readline().strip(), own._socket))
            running.terminate()
            assert running.wait(TIMEOUT_S) == 0
        own.close()
    compared = 0
    for log_ns, estimate in got["/estimate"]:
        if state := states.get(estimate["t_ns"]):
            compared += 1
            assert log_ns == state.t_ns + state.utc_offset_ns
            assert (estimate["q_nb"], estimate["v_mps"]) == (list(state.q_nb), list(state.v))
            assert (estimate["lat_rad"], estimate["status"]) == (state.lat, state.status)
            assert estimate["sigma_gyro_bias_radps"] == list(state.sigma_bg)
    assert compared >= 3
    by_stamp = {state.t_ns + state.utc_offset_ns: state for state in states.values()}
    found = [(where, by_stamp[log_ns]) for log_ns, where in got["/location"] if log_ns in by_stamp]
    assert len(found) >= 3
    for where, state in found:
        assert where["latitude"] == pytest.approx(math.degrees(state.lat), abs=1e-12)
        assert where["position_covariance"][0] == pytest.approx(state.sigma_p[1] ** 2)
    for _, fix in got["/gnss/fixes"]:
        assert fix["arrival_ns"] > fix["t_ns"]
        near = min(states.values(), key=lambda s: abs(s.t_ns - fix["t_ns"]))
        assert fix["lat_rad"] == pytest.approx(near.lat, abs=30.0 / 6.4e6)
    assert got["/gnss/location"][0][1]["frame_id"] == "gnss_link"
    assert len({fix["t_ns"] for _, fix in got["/gnss/fixes"]}) == len(got["/gnss/fixes"])  # each once


def drained(socket):
    """All records that have come."""
    socket.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while record := socket.recv(2 * client.RECORD.size):
            yield record


def record(seq, t_ns):
    row = np.zeros(1, SOLUTION)
    row["t_ns"], row["status"], row["q_nb"] = t_ns, 1, (1.0, 0.0, 0.0, 0.0)
    head = struct.pack("<4sHHQq", b"IMUD", client.VERSION, client.RECORD.size, seq, 10**18)
    return head + row.tobytes()


def test_a_state_becomes_the_row_that_it_was():
    row = np.zeros(1, SOLUTION)
    row.view(np.float64)[2:] = np.random.default_rng(3).normal(size=row.itemsize // 8 - 2)
    row["t_ns"], row["status"] = 123, 135
    sent = struct.pack("<4sHHQq", b"IMUD", client.VERSION, client.RECORD.size, 5, 10**18) + row.tobytes()
    assert solution_of(client.decode(sent)).tobytes() == row.tobytes()


@pytest.mark.parametrize("rate_hz", [1.0, 30.0, 400.0, 5000.0])
def test_one_state_of_each_period(rate_hz):
    """1000 states/s for ten seconds, a few lost, with the divisor that is asked for obeyed at once."""
    decimator, divisor, sent, kept = Decimator(rate_hz), 1, 0, []
    for seq in range(10_000):
        if seq % divisor == 0 and not 48 <= seq <= 52:
            state = client.decode(record(seq, seq * 1_000_000))
            sent += 1
            divisor = decimator.divisor(state) or divisor
            kept += [seq] if decimator.accepts(state) else []
    assert len(kept) == pytest.approx(10.0 * min(rate_hz, 1000.0), rel=0.05)
    assert sent <= 60 + 10_000 / max(1, int(1000.0 / rate_hz))


def test_a_fix_survives_the_gpsd_socket():
    """With nothing known but the position, and with everything."""
    least = {"t_mono_ns": 5, "arrival_mono_ns": 6, "quality": 1, "uSat": -1, "lat_deg": 45.0, "lon_deg": -90.0}
    fix = fix_of(least)
    assert (fix["lat"], fix["lon"], fix["t_ns"], fix["arrival_ns"]) == (math.pi / 4, -math.pi / 2, 5, 6)
    unknown = [fix[name] for name in ("height", "hdop", "speed", "course", "sigma", "v", "sigma_v")]
    assert np.isnan(np.hstack(unknown)).all()
    names = ("height_m", "sn_m", "se_m", "sd_m", "hdop", "vn_mps", "ve_mps", "vd_mps", "speed_mps")
    whole = fix_of(least | {name: 1.0 + k for k, name in enumerate(names)} | {"svd_mps": 0.5, "course_deg": 180.0})
    assert (whole["height"], whole["hdop"], whole["speed"], whole["course"]) == (1.0, 5.0, 9.0, math.pi)
    assert (whole["sigma"].tolist(), whole["v"].tolist()) == ([2.0, 3.0, 4.0], [6.0, 7.0, 8.0])
    assert whole["sigma_v"][2] == 0.5
    assert whole.dtype == FIX


@pytest.mark.thorough
def test_a_daemon_may_come_late_and_go_and_a_slow_viewer_costs_only_itself(tmp_path):
    """A daemon of the test's own: a SEQPACKET socket. One viewer never reads; the other gets every state."""
    path = tmp_path / "imud.stream"

    async def both(url, send):
        async with viewer(url) as slow, viewer(url) as quick:
            await slow.subscribe("/estimate")
            await quick.subscribe("/estimate")
            seen = []
            sending = asyncio.get_running_loop().run_in_executor(None, send)
            async for _, _, estimate in quick.messages():
                seen.append(estimate["t_ns"])
                if seen[-1] == LAST_NS:
                    break
            await sending
            return seen

    with server(path, "--gpsd", tmp_path / "none", "--listen", "127.0.0.1:0", "--rate", "1000", stderr=-1) as running:
        url = running.stdout.readline().strip()
        assert "no such file" in running.stderr.readline()
        for _ in range(2):  # two daemons, one after the other
            with scripted_stream(path) as accept:
                connection = accept()
                seen = asyncio.run(both(url, lambda connection=connection: send_states(connection)))
                connection.close()
            path.unlink()
        assert seen[-1] == LAST_NS
        assert seen == sorted(set(seen))
        running.terminate()
        assert running.wait(TIMEOUT_S) == 0
        assert "trying again" in running.stderr.read()


STATES = 20_000  # of 600 bytes and more: beyond what sockets buffer for the one that does not read
LAST_NS = (STATES - 1) * 1_000_000


@contextlib.contextmanager
def scripted_stream(path):
    import socket

    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(path))
        listening.listen()
        listening.settimeout(TIMEOUT_S)
        yield lambda: listening.accept()[0]


def send_states(connection):
    """At most as fast as they are taken."""
    connection.settimeout(TIMEOUT_S)
    for seq in range(STATES):
        connection.send(record(seq, seq * 1_000_000))
        if seq % 100 == 0:
            time.sleep(0.005)


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["x", "--listen", "/tmp/x"], 64, "open no Unix sockets"),
        (["x", "--listen", "::::"], 64, "no address"),
        (["x", "--gpsd", "a:b:c"], 64, "--gpsd"),
        ([], 64, "STREAM"),
    ],
)
def test_mistakes_are_named(arguments, code, text):
    with server(*arguments, stderr=subprocess.PIPE) as running:
        assert running.wait(TIMEOUT_S) == code
        assert text in running.stderr.read()


def test_an_address_in_use_is_named(tmp_path):
    with server(tmp_path / "x", "--listen", "127.0.0.1:0", stderr=subprocess.PIPE) as first:
        address = first.stdout.readline().strip().removeprefix("ws://")
        with server(tmp_path / "x", "--listen", address, stderr=subprocess.PIPE) as second:
            assert second.wait(TIMEOUT_S) == 73
            assert address in second.stderr.read()
