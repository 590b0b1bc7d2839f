"""Devices in memory and a line without a port: dialogues run against them in simulated time."""

import itertools
import struct

STEP_S = 0.001
RATES = {1: 1000.0, 2: 500.0, 3: 250.0, 4: 125.0, 5: 62.5, 6: 31.25, 7: 15.625}
LEAST_EXCHANGE_S = 0.0005  # what even an exchange that listens to nothing takes


def run(dialogue, device):
    """Run a dialogue against `device`; returns its result and the time it took."""
    time_s, answer = 0.0, None
    try:
        while True:
            exchange = dialogue.send(answer)
            if exchange.baud is not None:
                device.host_baud = exchange.baud
            if exchange.discard:
                device.outgoing.clear()
            device.receive_from(exchange.send)
            heard, waited, is_enough = bytearray(), 0.0, False
            while waited < exchange.listen_s and not is_enough:
                device.pass_time(STEP_S)
                waited += STEP_S
                if device.outgoing:  # only bytes that come may make it enough, as in `DialogueRunner`
                    heard += device.outgoing
                    device.outgoing.clear()
                    is_enough = exchange.enough is not None and exchange.enough(bytes(heard))
            device.pass_time(LEAST_EXCHANGE_S)
            time_s += waited + LEAST_EXCHANGE_S
            answer = bytes(heard)
    except StopIteration as finding:
        return finding.value, time_s


class Line:
    """One end of a wire; at the wrong speed only garbage passes, in both directions."""

    def __init__(self, baud):
        self.baud, self.host_baud = baud, 0
        self.outgoing, self.written = bytearray(), bytearray()
        self.now_s = 0.0

    def say(self, data):
        same = self.host_baud == self.baud
        self.outgoing += data if same else bytes((byte * 37 + 129) & 0xFF | 0x80 for byte in data)

    def receive_from(self, data):
        self.written += data
        if self.host_baud == self.baud:
            self.receive(data)

    def receive(self, data):
        pass

    def pass_time(self, seconds):
        self.now_s += seconds


class Mute(Line):
    """A wire with nothing at its end."""


class Speaker(Line):
    """Says `burst` every `period_s`, whatever it hears."""

    def __init__(self, baud, burst, period_s=1.0, first_s=0.3):
        super().__init__(baud)
        self.burst, self.period_s, self.next_s = burst, period_s, first_s

    def pass_time(self, seconds):
        super().pass_time(seconds)
        if self.now_s >= self.next_s:
            self.next_s += self.period_s
            self.say(self.burst)


class Epson(Line):
    """What Epson's sensors share on a UART: commands are two bytes and a CR; nothing is heard while booting."""

    boot_s = 0.0
    silent_boot = True

    def __init__(self, baud):
        super().__init__(baud)
        self.input = bytearray()

    def receive(self, data):
        if self.now_s < self.boot_s and self.silent_boot:
            return
        self.input += data
        while b"\r" in self.input:
            command, _, self.input = self.input.partition(b"\r")
            if len(command) == 2:
                self.obey(*command)


def is_triggered(test):
    """EXT_SEL, bits 7 and 6 of MSC_CTRL: 2, a sample comes with each pulse on a pin, where nothing is connected."""
    return test >> 6 == 2


class G350(Epson):
    """An M-G350 on its UART as docs/protocols.md 1.2 to 1.5 describe it: registers by byte, modes, automatic frames."""

    def __init__(self, baud=460800, boot_s=0.0, silent_boot=True, product="G350PD11", serial="A0000123"):
        super().__init__(baud)
        self.boot_s, self.silent_boot = boot_s, silent_boot
        self.byte = dict.fromkeys(range(0x80), 0)
        self.byte |= {0x37: 1, 0x38: 1, 0x39: 0x04, 0x3B: 0x00}
        self.byte |= dict(zip(range(0x6A, 0x72), product.encode(), strict=False))
        self.byte |= dict(zip(range(0x74, 0x7C), serial.encode(), strict=False))
        self.byte |= {0x72: 0x13, 0x73: 0x01}
        self.stuck = {}  # bytes that keep their value
        self.absent = set()  # words that are not answered
        self.restarts = 0
        self.next_frame_s = 0.0
        self.frames = itertools.count()

    @property
    def sampling(self):
        return not self.byte[0x39] & 0x04

    @property
    def streaming(self):
        return self.sampling and self.byte[0x3A] & 1 and not is_triggered(self.byte[0x34])

    @property
    def rate_hz(self):
        return RATES[self.byte[0x37]]

    def start(self, rate_code=1):
        """As a host before left it: streaming."""
        self.byte |= {0x37: rate_code, 0x3A: 1, 0x50: 1, 0x39: 0}
        self.next_frame_s = self.now_s
        return self

    def obey(self, address, value):
        if address & 0x80:
            self.store(address & 0x7F, value)
        elif not (self.sampling and self.byte[0x3A] & 1) and address & 0x7E not in self.absent:
            self.say(bytes((address & 0x7E, *self.word(address & 0x7E), 0x0D)))

    def store(self, address, value):
        if address == 0x39:
            self.byte[0x39] = 0x04 if value == 2 else self.byte[0x39] if value != 1 else 0x00
            self.next_frame_s = self.now_s + 1.0 / self.rate_hz
        elif address == 0x3E and value & 0x80:
            self.restarts += 1
            self.boot_s = self.now_s + 0.8
            self.byte |= {0x39: 0x04, 0x3A: 0, 0x50: 0}
        elif not self.sampling:
            self.byte[address] = value
        self.byte |= self.stuck

    def word(self, address):
        high, low = self.byte[address + 1], self.byte[address]
        if address == 0x3E and self.now_s < self.boot_s:
            high |= 0x04
        return high, low

    def pass_time(self, seconds):
        super().pass_time(seconds)
        while self.streaming and self.now_s >= self.next_frame_s:
            self.next_frame_s += 1.0 / self.rate_hz
            count = struct.pack(">H", 2 * next(self.frames) & 0xFFFF) if self.byte[0x50] & 1 else b""
            self.say(b"\x20" + struct.pack(">Hh6hH", 0xFE00, -15214, 1, 2, 3, 4, 5, -8000, 0) + count + b"\r")


WINDOWED_RATES = {0: 2000.0, **RATES, 8: 400.0, 9: 200.0, 10: 100.0, 11: 80.0, 12: 50.0, 13: 40.0, 14: 25.0, 15: 20.0}


class Windowed(Epson):
    """An M-G364 or other successor (docs/protocols.md 1.7): registers in two windows, frames as BURST_CTRL says."""

    def __init__(self, baud=460800, boot_s=0.0, product="G364PDCA", serial="W0000456"):
        super().__init__(baud)
        self.boot_s, self.window, self.restarts = boot_s, 0, 0
        text = {0x6A: product, 0x74: serial}
        self.names = {(1, at + i): ord(char) for at, string in text.items() for i, char in enumerate(string)}
        self.names |= {(0, 0x4C): 0x45, (0, 0x4D): 0x53, (1, 0x72): 0x30, (1, 0x73): 0x02}
        self.stuck = {}  # bytes that keep their value, by window and address
        self.frames = itertools.count()
        self.test_s, self.tested_s = 0.15, 0.0
        self.reset()

    def reset(self):
        self.byte = dict.fromkeys(itertools.product((0, 1), range(0x80)), 0) | self.names
        self.byte |= {(0, 0x03): 4, (1, 0x05): 1, (1, 0x04): 3, (1, 0x06): 1, (1, 0x0D): 0xF0, (1, 0x0C): 6}
        self.byte |= {(1, 0x39): 0x40, (1, 0x41): 0x40, (1, 0x49): 0x40}  # of the rotation matrix
        self.matrix = [self.byte[1, 0x38 + i] for i in range(36)]
        self.byte |= self.stuck

    @property
    def sampling(self):
        return not self.byte[0, 0x03] & 0x04

    @property
    def automatic(self):
        return self.sampling and self.byte[1, 0x08] & 1

    @property
    def rate_hz(self):
        return WINDOWED_RATES[self.byte[1, 0x05]]

    def start(self, rate_code=1, fields=0xF006, wide=0, window=0):
        """As a host before left it: streaming."""
        self.byte |= {(1, 0x05): rate_code, (1, 0x08): 1, (1, 0x0C): fields & 0xFF, (1, 0x0D): fields >> 8}
        self.byte |= {(1, 0x0F): wide, (0, 0x03): 0}
        self.next_frame_s, self.window = self.now_s, window
        return self

    def obey(self, address, value):
        if address & 0x80:
            self.store(address & 0x7F, value)
        elif not self.automatic:
            address &= 0x7E
            self.say(bytes((address, self.byte[self.window, address + 1], self.byte[self.window, address], 0x0D)))

    def store(self, address, value):
        if address == 0x7E:
            self.window = value & 1
        elif (self.window, address) == (0, 0x03):
            self.byte[0, 0x03] = {1: 0, 2: 4}.get(value, self.byte[0, 0x03])
            self.next_frame_s = self.now_s + 1.0 / self.rate_hz
        elif (self.window, address) == (1, 0x0A) and value & 0x80:
            self.restarts += 1
            self.boot_s = self.now_s + 0.8
            self.reset()
        elif not self.sampling and (self.window, address) not in self.names:
            self.byte[self.window, address] = value
            if (self.window, address, value) == (1, 0x03, 0x04):
                self.tested_s = self.now_s + self.test_s
        self.byte |= self.stuck

    def frame(self):
        fields, wide = self.byte[1, 0x0D] << 8 | self.byte[1, 0x0C], self.byte[1, 0x0F] << 8
        parts = [(0x8000, "H", [0xFE00]), (0x4000, "h", [2634]), (0x2000, "h", [1, 2, 3]), (0x1000, "h", [4, 5, -8000])]
        parts += [(0x0004, "H", [0x0200]), (0x0002, "H", [next(self.frames) & 0xFFFF])]
        body = b""
        for bit, form, values in parts:
            if fields & bit:
                shift, size = (16, "i") if wide & bit else (0, form)
                body += struct.pack(f">{len(values)}{size}", *[value << shift for value in values])
        if fields & 1:
            body += struct.pack(">H", sum(struct.unpack(f">{len(body) // 2}H", body)) & 0xFFFF)
        return b"\x80" + body + b"\r"

    def pass_time(self, seconds):
        super().pass_time(seconds)
        if self.now_s >= self.tested_s:
            self.byte[1, 0x03] &= ~0x04
        while self.automatic and not is_triggered(self.byte[1, 0x02]) and self.now_s >= self.next_frame_s:
            self.next_frame_s += 1.0 / self.rate_hz
            self.say(self.frame())
