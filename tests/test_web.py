"""`imud web`: what its server gives to whom."""

import asyncio
import contextlib
import json
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import pytest

aiohttp = pytest.importorskip("aiohttp", reason="the live page needs the extra imud[web]")
pytest.importorskip("plotly", reason="the live page needs the extra imud[web]")

from processes import TIMEOUT_S, daemon, process  # noqa: E402

from imud.commands import web  # noqa: E402
from imud.errors import UsageError  # noqa: E402

EST = {"class": "EST", "seq": 1, "t_mono_ns": 5, "roll_deg": 12.5, "state": "attitude"}


@contextlib.contextmanager
def page_server(address, listen="127.0.0.1:0"):
    """`imud web` for the daemon at `address`: its URL."""
    with process("imud", "web", f"--listen={listen}", str(address), stdout=subprocess.PIPE) as running:
        yield running.stdout.readline().strip()


@contextlib.asynccontextmanager
async def scripted_daemon(path, *lines, answer=bytes):
    """A socket that says these lines to whoever asks, and `answer()` to what is asked later; yields the requests."""
    asked, writers = [], []

    async def serve(reader, writer):
        writers.append(writer)
        asked.append(await reader.readline())
        writer.write(b"".join(line + b"\r\n" for line in lines))
        with contextlib.suppress(ConnectionError):
            while line := await reader.readline():
                asked.append(line)
                writer.write(answer())

    path.unlink(missing_ok=True)
    server = await asyncio.start_unix_server(serve, path)
    try:
        yield asked
    finally:
        server.close()
        for writer in writers:
            writer.close()


async def heard(channel, accept, seconds=TIMEOUT_S):
    """The first news that `accept` takes."""
    async with asyncio.timeout(seconds):
        while "control" in (news := await channel.receive_json()) or not accept(news):
            pass
    return news


def test_snapshots_follow_the_daemon_when_it_starts_and_ends(tmp_path):
    path = tmp_path / "gpsd.sock"

    async def follow(url):
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}live") as channel:
            news = await heard(channel, lambda n: not n["connected"] and "no such file" in n["why"])
            assert news["daemon"] == f"unix:{path}"
            async with scripted_daemon(path, b'{"class":"VERSION"}', json.dumps(EST).encode()) as asked:
                news = await heard(channel, lambda n: "EST" in n)
                assert news["connected"] and news["EST"] == EST
                watch = json.loads(asked[0].removeprefix(b"?WATCH="))
                assert 10 <= watch["rate"] <= 20 and {"ATT", "EST", "SKY", "TPV"} == set(watch["class"].split(","))
            async with scripted_daemon(path, b"SSH-2.0-OpenSSH_9.2"):
                news = await heard(channel, lambda n: "gpsd's protocol" in (n["why"] or ""))
                assert "EST" not in news  # nothing old is shown as if it were new

    with page_server(path) as url:
        asyncio.run(follow(url))


def test_why_there_is_no_connection_is_said_in_the_systems_words():
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))  # and does not listen
        address = f"127.0.0.1:{closed.getsockname()[1]}"

        async def follow(url):
            async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}live") as channel:
                news = await heard(channel, lambda n: n["why"] != "not yet connected")
                assert (news["daemon"], news["why"]) == (address, "connection refused")

        with page_server(address) as url:
            asyncio.run(follow(url))


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Origin": "http://{host}"}, 200),
        ({"Host": "localhost:80"}, 200),
        ({"Origin": "http://evil.example"}, 403),
        ({"Host": "evil.example"}, 403),
        ({"Origin": "null"}, 403),
    ],
)
def test_other_sites_pages_read_nothing(headers, status, served):
    async def ask():
        host = served.removeprefix("http://").rstrip("/")
        given = {key: value.format(host=host) for key, value in headers.items()}
        async with aiohttp.ClientSession() as session, session.get(served, headers=given) as answer:
            return answer.status

    assert asyncio.run(ask()) == status


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    with page_server(tmp_path_factory.mktemp("web") / "absent.sock") as url:
        yield url


def test_prometheus_reads_the_daemons_status(tmp_path):
    parser = pytest.importorskip("prometheus_client.parser")
    with page_server(tmp_path / "gpsd.sock") as url:
        with pytest.raises(urllib.error.HTTPError, match="503") as absent:
            urllib.request.urlopen(f"{url}metrics")
        assert "no daemon answers" in absent.value.read().decode()
        with daemon(tmp_path, "--port", str(tmp_path / "imu")), urllib.request.urlopen(f"{url}metrics") as answer:
            assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
            families = {family.name for family in parser.text_string_to_metric_families(answer.read().decode())}
    assert {"imud_info", "imud_port_info", "imud_uptime_seconds"} <= families


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("headers", "status"), [({}, 101), ({"Origin": "http://evil.example"}, 403), ({"Host": "evil.example"}, 403)]
)
def test_other_sites_pages_record_nothing(headers, status, tmp_path):
    path = tmp_path / "gpsd.sock"

    async def ask(url):
        async with scripted_daemon(path, b'{"class":"VERSION"}', json.dumps(EST).encode()) as asked:
            async with aiohttp.ClientSession() as session:
                try:
                    async with session.ws_connect(f"{url}live", headers=headers) as channel:
                        assert await channel.receive_json() == {"control": True}
                        await heard(channel, lambda n: "EST" in n)
                        for text in ("no such order", "record", "stop"):
                            await channel.send_str(text)
                        async with asyncio.timeout(TIMEOUT_S):
                            while len(orders(asked)) < 2:
                                await asyncio.sleep(0.05)
                        found = 101
                except aiohttp.WSServerHandshakeError as error:
                    found = error.status
            return found, orders(asked)

    def orders(asked):
        return [line for line in asked if b"enable" in line and b"WATCH" not in line]

    with page_server(path) as url:
        found, given = asyncio.run(ask(url))
    assert found == status
    wanted = [b'?RECORD={"enable": true}', b'?RECORD={"enable": false}'] if status == 101 else []
    assert [line.strip() for line in given] == wanted


def test_the_page_is_whole_and_asks_nothing_of_other_machines(served):
    async def fetch():
        async with aiohttp.ClientSession(served) as session:
            for path, beginning in (("/", "<!DOCTYPE html>"), ("/page/main.js", "//"), ("/plotly.js", "/**")):
                async with session.get(path) as answer:
                    assert answer.status == 200
                    assert (await answer.text()).startswith(beginning)
                    assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
            async with session.get("/page/../server.py") as answer:
                assert answer.status == 404

    asyncio.run(fetch())


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--listen", "/tmp/x"], 64, "HOST:PORT"),
        (["nowhere:at:all"], 64, "gpsd socket"),
        (["--listen", "127.0.0.1:99999"], 64, "65535"),
        (["--listen", "99999"], 64, "65535"),
    ],
)
def test_a_bad_address_is_reported(arguments, code, says):
    command = [sys.executable, "-m", "imud", "web", *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert (ended.returncode, ended.stdout) == (code, "")
    assert says in ended.stderr and "Traceback" not in ended.stderr


def test_a_port_in_use_is_reported(served):
    command = [sys.executable, "-m", "imud", "web", "--listen", served.removeprefix("http://").rstrip("/")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert ended.returncode == 73 and "in use by" in ended.stderr


def test_without_the_extra_the_remedy_is_named(monkeypatch):
    monkeypatch.setattr(web.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(UsageError, match=r"pip install 'imud\[web\]'"):
        web.require()
