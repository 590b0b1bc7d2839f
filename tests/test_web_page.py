"""The page of `imud web` in a real browser, fed by a real daemon or by scripted lines."""

import asyncio
import itertools
import json
import math
import subprocess
import sys

import pytest
from browser import DESKTOP, PHONE, browser, program
from processes import daemon
from test_web import EST, aiohttp, heard, page_server, scripted_daemon  # which is skipped without the extra

pytestmark = pytest.mark.skipif(program() is None, reason="no Chromium here")

LINK = "document.getElementById('link').textContent"
NUMBERS = "document.getElementById('angles').innerText"
POINTS = "document.querySelector('#charts .chart').data?.at(-1).x.length ?? 0"
INK = """(() => { const c = document.getElementById('%s'); const d = c.getContext('2d')
  .getImageData(0, 0, c.width, c.height).data; return new Set(new Uint32Array(d.buffer)).size })()"""


async def renders_and_moves(page):
    await page.until(f"{LINK} === 'live'")
    await page.until(f"/roll\\s+-?\\d/.test({NUMBERS})")
    before = await page.evaluate(NUMBERS)
    await page.until(f"{NUMBERS} !== {json.dumps(before)}")
    for canvas in ("horizon", "compass", "pose"):
        assert await page.evaluate(INK % canvas) > 10, canvas


RECORDED = "document.getElementById('recorded').textContent"
BUTTON = "document.getElementById('record')"


async def records(page, folder):
    """By its button; returns the file."""
    await page.until(f"!{BUTTON}.hidden && {BUTTON}.textContent.includes('record') && {RECORDED} === ''")
    await page.evaluate(f"{BUTTON}.click()")
    await page.until(f"{BUTTON}.textContent.includes('stop') && /imud-.*Z.mcap, [1-9]/.test({RECORDED})")
    await page.evaluate(f"{BUTTON}.click()")
    await page.until(f"!{BUTTON}.textContent.includes('stop') && {RECORDED} === ''")
    (path,) = folder.iterdir()
    return path


WATCH_NORTH = """(() => { const plain = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    if (text === "x" && this.canvas.id === "pose") window.drawn = true;
    if (text === "N" && this.canvas.id === "pose") window.north = [x / this.canvas.height, y / this.canvas.height];
    plain.call(this, text, x, y); } })()"""


async def press(page, key, code):
    for kind in ("keyDown", "keyUp"):
        await page.do("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)


async def turns_by_arrow_keys(page):
    """Keys as of a keyboard: Tab comes to the view, arrows turn it, by 10 deg, and the page does not scroll."""
    await page.evaluate("scrollTo(0, 0)")
    await page.evaluate(WATCH_NORTH)
    for _ in range(30):
        await press(page, "Tab", 9)
        if await page.evaluate("document.activeElement.id") == "pose":
            break
    assert await page.evaluate("document.activeElement.matches('#pose:focus-visible')")
    await page.until("window.north")
    (x, y), scrolled = await page.evaluate("window.north"), await page.evaluate("scrollY")
    await press(page, "ArrowRight", 39)
    await page.until(f"Math.abs(window.north[0] - {x}) > 0.01")
    turned = (await page.evaluate("window.north"))[0] / x
    assert turned == pytest.approx(math.sin(math.radians(40.0)) / math.sin(math.radians(30.0)), rel=1e-6)
    await press(page, "ArrowLeft", 37)
    await page.until(f"Math.abs(window.north[0] - {x}) < 1e-6")
    await press(page, "ArrowUp", 38)
    await page.until(f"Math.abs(window.north[1] - {y}) > 0.01")
    assert await page.evaluate("scrollY") == scrolled
    await press(page, "ArrowDown", 40)
    await page.until(f"Math.abs(window.north[1] - {y}) < 1e-6")


async def draws_without_a_size(page):
    """The first news may come before the page is laid out: canvases have no size then."""
    drawings = (
        "const [{ drawHorizon, drawCompass }, { drawPose }] = await Promise.all(['horizon', 'pose'].map((name) => "
        "import(`/page/${name}.js`)));"
        "drawHorizon(document.createElement('canvas'), 1, 2);"
        "drawCompass(document.createElement('canvas'), 30, 2, true);"
        "drawPose(document.createElement('canvas'), [1, 0, 0, 0]);"
    )
    assert await page.evaluate(f"(async () => {{ {drawings} return true; }})()")


async def fits(page):
    for size in (DESKTOP, PHONE):
        for scheme in ("light", "dark"):
            await page.size(size, scheme)
            await page.until(f"innerWidth === {size[0]} && document.documentElement.scrollWidth <= {size[0]}", 20.0)
    await page.size(DESKTOP)


_COUNTED = {"age_s": 0.1, "used": 590, "rejected": 128, "ratio": 3347.1}
SOURCES = {
    "odometer": _COUNTED | {"scale": 1.0154, "sscale": 0.002, "share.velocity": 0.07, "share.heading": 0.004}
    | {"finding": "the accelerometer contradicts it"},
    "barometer": _COUNTED | {"rejected": 0, "ratio": 0.33, "age_s": 7.4, "offset_m": -29.4, "soffset_m": 0.41},
}  # fmt: skip
PORTS = (
    {
        "path": "/dev/imu",
        "streaming": True,
        "model": "M-G350",
        "serial": "S42",
        "baud": 460800,
        "health": "odd; and more",
    },
    {"path": "/dev/wheel", "streaming": False, "description": "there is no /dev/wheel; trying again"},
    {"path": "/dev/baro", "streaming": True, "driver": "nmea", "baud": 4800, "health": "stale"},
)
MEASUREMENTS = [
    "odometer not used: the accelerometer contradicts it 590 used, 128 rejected ratio 3347 scale 1.0154 ± 0.002"
    " share: velocity 7 %",
    "barometer silent for 7 s 590 used, 0 rejected ratio 0.33 offset -29.4 ± 0.41 m",
    "refused 3 for value; the last line: <b>BARO</b> without pressure",
]
DEVICES = ["imu M-G350 S42, 460800 baud", "wheel there is no /dev/wheel; trying again", "baro nmea, 4800 baud; stale"]
SAID = (
    "[...document.querySelectorAll('#%s tr')].map((row) => [...row.children].map((cell) => cell.textContent)"
    ".filter(Boolean).join(' '))"
)
RED = "[...document.querySelectorAll('#aiding tr.bad, #health tr:has(.bad)')].map((row) => row.children[0].textContent)"


@pytest.mark.thorough
@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_the_page_shows_each_port_and_each_source_of_measurements_and_why_one_is_not_used(size, tmp_path):
    status = {"class": "STATUS", "aiding.refused.value": 3, "aiding.last_refused": "<b>BARO</b> without pressure"}
    status |= {f"aiding.sources.{name}.{key}": value for name, its in SOURCES.items() for key, value in its.items()}
    status |= {f"ports.{i}.{key}": value for i, port in enumerate(PORTS) for key, value in port.items()}
    est = EST | {"imu_health": "odd", "gnss_health": "ok"}

    async def look(url, answer):
        async with scripted_daemon(tmp_path / "gpsd.sock", *answer), browser(tmp_path / "profile") as page:
            await page.open(url)
            await page.size(size)
            await page.until(f"{SAID % 'aiding'}.length === 3")
            assert await page.evaluate(SAID % "aiding") == MEASUREMENTS
            assert (await page.evaluate(SAID % "health"))[:3] == DEVICES
            assert await page.evaluate(RED) == ["wheel", "baro", "inertial sensor", "odometer", "barometer"]
            await page.until(f"document.documentElement.scrollWidth <= {size[0]}")
            assert page.errors == []

    with page_server(tmp_path / "gpsd.sock") as url:
        asyncio.run(look(url, [json.dumps(line).encode() for line in ({"class": "VERSION"}, est, status)]))


def test_the_page_shows_what_the_filter_has_found_of_receiver_and_vehicle(tmp_path):
    states = {"time_offset_s": 0.153, "stime_offset_s": 0.0121, "mount_yaw_deg": 0.3, "smount_yaw_deg": 0.2}
    status = {"class": "STATUS", "aiding.sources.odometer.received": 7, "version": "1"}
    status |= {f"states.{name}": value for name, value in states.items()}
    lines = [json.dumps(line).encode() for line in ({"class": "VERSION"}, EST, status)]

    async def look(url):
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}live") as channel:
            news = await heard(channel, lambda n: "STATUS" in n)
        found = {"fixes late by": "+0.153 ±0.012 s"}
        assert news["STATUS"] == {"class": "STATUS", "aiding.sources.odometer.received": 7, "found": found}
        async with browser(tmp_path / "profile") as page:
            await page.open(url)
            text = "document.getElementById('health').innerText"
            await page.until(f"/fixes late by\\s+\\+0.153 ±0.012 s/.test({text})")
            assert "vehicle" not in await page.evaluate(text)
            assert page.errors == []

    async def serve(url):
        async with scripted_daemon(tmp_path / "gpsd.sock", *lines):
            await look(url)

    with page_server(tmp_path / "gpsd.sock") as url:
        asyncio.run(serve(url))


YAW = {"q0": 1, "q1": 0, "q2": 0, "q3": 0, "pitch_deg": 0.0, "sroll_deg": 0.5, "spitch_deg": 0.5, "imu_health": "ok"}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("state", "yaw_deg", "syaw_deg", "row"),
    [
        ("attitude", 0.1, 103.923, "yaw –"),
        ("attitude", 0.1, 0.04, "yaw 0.10 ± 0.040"),
        ("attitude,heading", -160.0, 1.25, "heading 200.00 ± 1.3"),
        ("attitude", -160.0, 101.5, "yaw 200.00 ± 102"),
    ],
)
def test_a_yaw_is_shown_for_what_it_is_and_stays_when_the_sensor_is_silent(state, yaw_deg, syaw_deg, row, tmp_path):
    est = EST | YAW | {"state": state, "yaw_deg": yaw_deg, "syaw_deg": syaw_deg}
    lines = [json.dumps(line).encode() for line in ({"class": "VERSION"}, est)]
    motion, health = (
        f"document.getElementById('{name}').innerText.replace(/\\s+/g, ' ')" for name in ("motion", "health")
    )

    async def serve(url):
        sky = b'{"class":"SKY","uSat":9}\r\n'
        scripted = scripted_daemon(tmp_path / "gpsd.sock", *lines, answer=lambda: sky)
        async with scripted, browser(tmp_path / "profile") as page:
            await page.open(url)
            await page.until(f"{health}.includes('satellites in use 9') && {LINK}.startsWith('no sensor data')")
            await page.until(f"{health}.startsWith('inertial sensor – receiver –')")
            assert (await page.evaluate(motion)).startswith(f"{row} deg" if "±" in row else row)
            await page.evaluate(WATCH_NORTH)
            await page.evaluate("document.getElementById('pose').focus()")
            await press(page, "ArrowRight", 39)
            await page.until("window.drawn")
            assert (await page.evaluate("Boolean(window.north)")) == ("heading" in state)
            assert page.errors == []

    with page_server(tmp_path / "gpsd.sock") as url:
        asyncio.run(serve(url))


@pytest.mark.thorough
def test_without_estimates_or_beside_those_without_a_position_the_receivers_is_shown(tmp_path):
    tpv = {"class": "TPV", "device": "/dev/gnss", "mode": 3, "lat": 48.5, "lon": 11.25, "altHAE": 520.0}
    tpv |= {"epx": 1.96, "epy": 3.92, "epv": 5.88, "velN": 1.5, "velE": -2.5, "eps": 0.196}
    tilt = EST | YAW | {"device": "/dev/imu", "yaw_deg": 0.0, "syaw_deg": 103.923}
    place = "document.getElementById('place').innerText.replace(/\\s+/g, ' ')"
    shown = "latitude 48.500000° ± 2.0 m longitude 11.250000° ± 1.0 m height 520.00 ± 3.0 m v north 1.50 ± 0.10 m/s"

    numbers = itertools.count(1)

    def newer(*messages):
        """These messages, each time as of a later instant."""
        n = next(numbers)
        times = {"t_mono_ns": n, "time": f"2026-03-23T12:{n // 60:02}:{n % 60:02}Z"}
        return b"".join(json.dumps(message | times).encode() + b"\r\n" for message in messages)

    async def is_shown(url, page, link, *messages):
        scripted = scripted_daemon(tmp_path / "gpsd.sock", b'{"class":"VERSION"}', answer=lambda: newer(*messages))
        async with scripted:
            await page.open(url)
            await page.until(f"{place}.startsWith('{shown}') && {LINK} === {json.dumps(link)}")

    async def look(url):
        async with browser(tmp_path / "profile") as page:
            await is_shown(url, page, "no inertial sensor: the receiver's fixes", tpv)
            await is_shown(url, page, "live", tilt, tpv)
            assert page.errors == []

    with page_server(tmp_path / "gpsd.sock") as url:
        asyncio.run(look(url))


@pytest.mark.thorough
def test_a_chart_that_left_the_screen_and_came_back_between_two_frames_is_drawn(tmp_path):
    """The browser then tells both at once: the last counts."""
    drawn = """(async () => {
      window.IntersectionObserver = class { constructor(tell) { this.tell = tell; }
        observe() { this.tell([{ isIntersecting: false }, { isIntersecting: true }]); } };
      const plots = await import("/page/plots.js?again"), place = document.createElement("div");
      return new Promise((drawn) => {
        plots.addPlot(place, () => { drawn(true); return { traces: [], layout: {} }; });
        plots.drawInTurn(() => true); setTimeout(() => drawn(false), 5000); }); })()"""

    async def look(url):
        async with browser(tmp_path / "profile") as page:
            await page.open(url)
            assert await page.evaluate(drawn)

    with page_server(tmp_path / "gpsd.sock") as url:
        asyncio.run(look(url))


@pytest.mark.thorough
def test_the_track_is_broken_after_a_gap_and_where_a_fix_corrects_what_had_coasted(tmp_path):
    """Points are at 0, 1, 2 s …; metres north. Joined they would be spikes."""
    drawn = """(async () => {
      const track = await import("/page/track.js?again"), place = document.createElement("div");
      const other = { state: "", lon_deg: 10, vn_mps: 3, ve_mps: 0, sn_m: 1, se_m: 1 };
      const at = (t, m) => track.follow({ ...other, t_mono_ns: t * 1e9, lat_deg: m / 110574 });
      [[0, 0], [1, 3], [2, 6], [3, 60], [4, 63], [12, 66], [13, 69]].forEach(([t, m]) => at(t, m));
      track.follow({ state: "aligning" }); at(14, 72);
      document.body.prepend(place); track.makeTrack(place);
      while (!place.data) await new Promise((later) => setTimeout(later, 50));
      return place.data[0].y.map((y) => y === null ? null : Math.round(y)); })()"""

    async def look(url):
        async with browser(tmp_path / "profile") as page:
            await page.open(url)
            shown = await page.evaluate(drawn)
            assert shown == [0, 3, 6, None, 60, 63, None, 66, 69, None, 72, 72]
            assert page.errors == []

    with page_server(tmp_path / "gpsd.sock") as url:
        asyncio.run(look(url))


@pytest.mark.thorough
def test_in_a_browser_it_renders_moves_records_and_survives_restarts(tmp_path):
    ports = ("--port", "sim:car", "--port", "sim:car:nmea")
    socket, folder = tmp_path / "gpsd.sock", tmp_path / "recordings"
    folder.mkdir()

    async def look(url, page):
        await page.size(DESKTOP)
        await page.open(url)
        await page.until(f"{LINK}.startsWith('no daemon at')")
        await draws_without_a_size(page)
        with daemon(tmp_path, *ports, "--set", f"record.folder={folder}") as imud:
            await renders_and_moves(page)
            await turns_by_arrow_keys(page)
            path = await records(page, folder)
            await page.until("document.getElementById('track').data?.[0].x.length > 5")
            await page.evaluate("document.querySelector('#charts').scrollIntoView()")
            n = await page.until(POINTS)
            await page.until(f"{POINTS} > {n}")
            await fits(page)
            imud.says("recording to")
        await page.until(f"{LINK}.startsWith('no daemon at')")
        replayed = subprocess.run(
            [sys.executable, "-m", "imud", "replay", str(path), "-o", str(tmp_path / "est.csv")],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert (replayed.returncode, replayed.stderr) == (0, "")
        assert len((tmp_path / "est.csv").read_text().splitlines()) > 100

    async def come_back(page):
        """The web process is another one; so is the daemon, which allows no recordings."""
        with daemon(tmp_path, *ports):
            await renders_and_moves(page)
            await page.until(f"{BUTTON}.hidden")

    async def watch():
        async with browser(tmp_path / "profile") as page:
            with page_server(socket) as url:
                await look(url, page)
            await page.until(f"{LINK}.startsWith('imud web does not answer')")
            with page_server(socket, url.removeprefix("http://").rstrip("/")):
                await come_back(page)
            others = [error for error in page.errors if "ERR_CONNECTION_REFUSED" not in str(error)]
            assert others == []
            fetched = [address for address in page.requests if not address.startswith("data:")]  # those are nobody's
            assert {address.partition("/page")[0].rstrip("/") for address in fetched} <= {
                url.rstrip("/"),
                f"{url}plotly.js",
            }

    asyncio.run(watch())
