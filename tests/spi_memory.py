"""An SPI bus in memory in simulated time: dialogues and fetches against an emulated sensor, without waiting."""

import numpy as np

from imud.drivers.spi import Bus, Fetch
from imud.firmware_sim.epson_spi import EpsonSpi
from imud.firmware_sim.noise import IDEAL, ImuErrors

STEP_S = 1e-3
DPS, G = np.pi / 180.0, 9.80665
GOLDEN = (1.25 * DPS, -1.25 * DPS, 0.0, 0.0, 0.0, G)  # docs/protocols.md 1.5, synthetic vector


class Constant:
    """The same rates and forces for ever, rad/s and m/s^2."""

    end = np.inf

    def __init__(self, values=GOLDEN):
        self.values = np.array(values)

    def imu(self, t):
        return np.tile(self.values, (len(t), 1))


def golden():
    """Signal and errors of a sensor that measures the golden vector perfectly."""
    return Constant(), ImuErrors(IDEAL, np.random.default_rng(1), 2000.0)


class Memory:
    """The bus: words take their time and the pauses asked for, nothing more."""

    def __init__(self, sensor, now_s=1.0):
        self.spi = EpsonSpi(sensor)
        self.now_s, self.bus, self.fetch = now_s, Bus(0, 0, 0), None
        self.sent = []  # words

    def exchange(self, word, clock_hz, stall_us):
        answer = self.spi.transfer(word, self.now_s, clock_hz, self.bus.mode)
        self.sent.append(word)
        self.now_s += 8 * len(word) / clock_hz + stall_us * 1e-6
        return answer

    def words(self, data):
        return b"".join(
            self.exchange(data[i : i + 2], self.bus.clock_hz, self.bus.stall_us) for i in range(0, len(data), 2)
        )

    def sample(self):
        """What a fetch at this time brings: a frame, or nothing."""
        answers = b""
        for i, cycle in enumerate(self.fetch.cycles):
            answer = self.exchange(cycle.word, self.fetch.clock_hz, cycle.stall_us)
            if i == self.fetch.gate and not self.fetch.is_new(answer):
                return b""
            answers += answer
        return self.fetch.frame(answers)

    def run(self, dialogue):
        """The dialogue's finding."""
        heard = None
        try:
            while True:
                exchange = dialogue.send(heard)
                if isinstance(exchange.spi, Bus):
                    self.bus, self.fetch = exchange.spi, None
                elif isinstance(exchange.spi, Fetch):
                    self.fetch = exchange.spi
                heard = self.words(exchange.send)
                if self.fetch:
                    heard = b""
                begun_s = self.now_s
                while self.now_s - begun_s < exchange.listen_s and not (exchange.enough and exchange.enough(heard)):
                    self.now_s += STEP_S
                    if self.fetch:
                        heard += self.sample()
        except StopIteration as finding:
            return finding.value
