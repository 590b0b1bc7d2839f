"""A headless Chromium, driven over its DevTools protocol: just enough to open a page, look at it and ask it things."""

import asyncio
import contextlib
import itertools
import shutil
import subprocess
import time

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage"),
    "--remote-debugging-port=0",
)
START_S = TIMEOUT_S = 60.0
DESKTOP, PHONE = (1280, 900), (360, 740)


def program():
    """Path of Chromium, or None."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Page:
    """One page; what goes wrong in it is collected in `errors`, what it asks of the network in `requests`."""

    def __init__(self, channel):
        self._channel, self._numbers, self._answers = channel, itertools.count(1), {}
        self.errors, self.requests = [], []
        self._reading = asyncio.create_task(self._read())

    async def _read(self):
        async for frame in self._channel:
            message = frame.json()
            if "id" in message:
                self._answers.pop(message["id"]).set_result(message)
            elif message["method"] == "Runtime.exceptionThrown":
                self.errors.append(message["params"]["exceptionDetails"])
            elif message["method"] == "Log.entryAdded" and message["params"]["entry"]["level"] == "error":
                self.errors.append(message["params"]["entry"])
            elif message["method"] == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])

    async def do(self, method, **params):
        number = next(self._numbers)
        self._answers[number] = asyncio.get_running_loop().create_future()
        await self._channel.send_json({"id": number, "method": method, "params": params})
        answer = await asyncio.wait_for(self._answers[number], TIMEOUT_S)
        assert "error" not in answer, answer
        return answer["result"]

    async def open(self, url):
        for domain in ("Page", "Runtime", "Log", "Network"):
            await self.do(f"{domain}.enable")
        await self.do("Page.navigate", url=url)
        await self.until("location.href !== 'about:blank' && document.readyState === 'complete'")

    async def evaluate(self, expression):
        """The value of a JavaScript expression."""
        answer = await self.do("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def until(self, expression, seconds=TIMEOUT_S):
        """Wait until a JavaScript expression is true; its value."""
        deadline = time.monotonic() + seconds
        while not (value := await self.evaluate(expression)):
            text = await self.evaluate("document.body ? document.body.innerText : ''")
            assert time.monotonic() < deadline, f"not within {seconds} s: {expression}; errors {self.errors}\n{text}"
            await asyncio.sleep(0.1)
        return value

    async def size(self, size, scheme="light"):
        width, height = size
        await self.do(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=size == PHONE
        )
        await self.do("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])


@contextlib.asynccontextmanager
async def browser(profile):
    """A Page of a fresh Chromium whose profile is kept in the folder `profile`."""
    import aiohttp

    command = [program(), *FLAGS, f"--user-data-dir={profile}", "about:blank"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
        try:
            deadline = time.monotonic() + START_S
            port_file = profile / "DevToolsActivePort"
            while not (port_file.exists() and port_file.read_text().count("\n")):
                assert running.poll() is None and time.monotonic() < deadline, "Chromium does not start"
                await asyncio.sleep(0.1)
            port = port_file.read_text().split()[0]
            async with aiohttp.ClientSession() as session:
                async with session.get(f"http://127.0.0.1:{port}/json/list") as answer:
                    targets = await answer.json()
                url = next(t["webSocketDebuggerUrl"] for t in targets if t["type"] == "page")
                async with session.ws_connect(url, max_msg_size=0) as channel:
                    yield Page(channel)
        finally:
            running.terminate()
