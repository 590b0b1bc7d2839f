"""Setting up a MediaTek receiver: the emulated FV-M11 on a pseudo-terminal, and in memory when it misbehaves."""

import time

import numpy as np
import pytest
from emulated import REST, UTC, Emulated
from nmea_lines import gga, line, rmc, vtg
from processes import TIMEOUT_S, daemon, emulator
from scripted import Speaker, run

from imud.configuration.settings import Settings
from imud.drivers.detect import detect
from imud.drivers.driver import Identity, Options
from imud.drivers.nmea.driver import DRIVER, MEDIATEK
from imud.drivers.nmea.mtk import command, speaks_mtk
from imud.drivers.transport.dialogue_runner import run_dialogue
from imud.drivers.transport.portspec import PortSpec
from imud.drivers.transport.serial import SerialPort
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.nmea import FvM11
from imud.setup import choices
from imud.setup.config import load

FAST = Options(set_up_nmea=True)


@pytest.mark.parametrize(
    ("text", "sentence"),  # docs/protocols.md 4.3
    [
        ("220,200", b"$PMTK220,200*2C\r\n"),
        ("300,200,0,0,0,0", b"$PMTK300,200,0,0,0,0*2F\r\n"),
        ("251,57600", b"$PMTK251,57600*2C\r\n"),
        ("314,-1", b"$PMTK314,-1*04\r\n"),
    ],
)
def test_commands_are_those_of_the_manual(text, sentence):
    assert command(text) == sentence


def test_mediatek_receivers_identify_themselves():
    assert speaks_mtk(b"noise$PMTK010,001*2E\r\n")
    assert speaks_mtk(line("PMTK705,AXN_2.51_3339_19071200,0002,QUECTEL-L70,1.0"))  # of gpsd's quectel-L70.log
    assert not speaks_mtk(b"$PMTK010,001*2F\r\n" + gga())


class Device(Emulated):
    """The emulated receiver on a wire in memory. deaf: commands that it does not receive."""

    def __init__(self, baud=9600, deaf=(), **options):
        source = SimulatedFixes(REST, np.random.default_rng(1), UTC, True)
        super().__init__(FvM11(source, UTC, baud=baud, no_fix_s=0.0, **options))
        self.deaf = {str(number) for number in deaf}
        self.commands = []

    def receive_from(self, data):
        number = data[5:8].decode()
        if data:
            self.commands.append(number)
        if number not in self.deaf:
            super().receive_from(data)

    def listen(self, seconds):
        """What it says from now on."""
        self.outgoing.clear()
        for _ in range(int(seconds / 0.01)):
            self.pass_time(0.01)
        return bytes(self.outgoing)


def configure(device, options=FAST, model=MEDIATEK, baud=9600):
    device.host_baud = baud
    return run(DRIVER.configure(Identity("nmea", model, baud=baud), options), device)[0]


def fixes_in(data):
    return len(DRIVER.new_decoder().feed(data, 1))


@pytest.mark.parametrize("baud", [4800, 9600, 38400, 115200])
@pytest.mark.parametrize("periods", [(220, 300), (300,)])
def test_five_fixes_a_second_through_a_faster_line(baud, periods):
    device = Device(baud, periods=periods)
    configured = configure(device, baud=baud)
    assert configured.warnings == ()
    assert configured.identity.baud == device.unit.uart.baud == max(baud, 57600)
    data = device.listen(4.0)
    assert 15 <= fixes_in(data) <= 20, "the first may still be a second away"
    assert b"GPGSV" not in data
    assert b"GPGSA" in data


def test_a_receiver_whose_boot_was_missed_is_asked_who_it_is():
    device = Device()
    configured = configure(device, model="NMEA receiver")
    assert device.commands[0] == "605"
    assert configured.identity.model == MEDIATEK
    assert configured.warnings == ()


def test_another_makers_receiver_is_queried_and_left_unchanged():
    device = Speaker(9600, gga() + rmc() + vtg())
    configured = configure(device, model="NMEA receiver")
    assert bytes(device.written) == 3 * command("605")
    assert "not known to be a MediaTek" in configured.warnings[0]
    assert configured.identity.baud == 9600


@pytest.mark.parametrize("options", [Options(), Options(readonly=True, set_up_nmea=True)])
def test_nothing_is_written_unasked_or_to_a_readonly_port(options):
    device = Device()
    assert configure(device, options).warnings == ()
    assert device.written == b""


def test_two_retries_then_the_old_state():
    device = Device(deaf=("220", "300"))
    configured = configure(device)
    assert [device.commands.count(n) for n in ("220", "300")] == [6, 6]  # thrice to set, thrice to set back
    assert "both by PMTK220 and by PMTK300" in configured.warnings[0]
    assert configured.identity.baud == device.unit.uart.baud == 9600
    assert b"GPGSV" in device.listen(6.0), "the sentences are the receiver's own again"


def test_a_rate_that_it_refuses_leaves_the_old_state():
    device = Device()
    configured = configure(device, Options(fix_rate_hz=10.0, set_up_nmea=True))
    assert configured.warnings
    assert device.unit.uart.baud == 9600
    assert fixes_in(device.listen(10.0)) in (9, 10)


def test_a_receiver_that_keeps_its_speed_is_left_at_it():
    device = Device(deaf=("251",))
    configured = configure(device)
    assert "does not change to 57600 baud" in configured.warnings[0]
    assert configured.identity.baud == 9600
    assert b"GPGSV" in device.listen(6.0)


def test_sentences_that_cannot_be_chosen_change_nothing():
    device = Device(deaf=("314",))
    assert "PMTK314" in configure(device).warnings[0]
    assert set(device.commands) == {"314"}
    assert device.unit.uart.baud == 9600


def test_a_receiver_that_falls_silent_is_lost():
    class Dying(Device):
        def pass_time(self, seconds):
            super().pass_time(seconds)
            if "251" in self.commands:
                self.outgoing.clear()

    assert configure(Dying()) is None


def test_receivers_are_left_unchanged_by_default():
    assert Settings().gnss.configure is False
    assert not options_of().set_up_nmea and options_of("gnss.configure=true").set_up_nmea


def test_the_rate_of_fixes_is_for_every_receiver_that_is_set_up():
    """A u-blox receiver always is."""
    assert options_of("gnss.rate_hz=2").fix_rate_hz == 2.0
    assert options_of().fix_rate_hz == Settings().gnss.rate_hz == Options().fix_rate_hz


def options_of(*settings):
    [(_, options)] = choices.ports(load(None, ['ports=["/dev/a"]', *settings]))
    return options


@pytest.mark.parametrize("baud", [4800, 57600])
def test_on_a_pseudo_terminal(tmp_path, baud):
    link = tmp_path / "gnss"
    with emulator(f"nmea@{baud}", "--no-fix", "0.5", links=[link]):
        port = SerialPort(PortSpec.parse(str(link)))
        try:
            found = run_dialogue(port, detect("nmea"))
            configured = run_dialogue(port, DRIVER.configure(found, FAST))
            assert (configured.identity.baud, configured.warnings) == (57600, ())
            decoder, fixes, end = DRIVER.new_decoder(), [], time.monotonic() + TIMEOUT_S
            while len(fixes) < 12 and time.monotonic() < end:
                fixes += decoder.feed(port.read(), time.monotonic_ns())
                time.sleep(0.01)
        finally:
            port.close()
    steps = np.diff([fix.utc_s for fix in fixes]) % 86_400
    assert np.allclose(steps[4:], 0.2, atol=1e-6)


def test_the_daemon_sets_the_receiver_up_when_asked(tmp_path):
    imu, gnss = tmp_path / "imu", tmp_path / "gnss"
    ports = ("--port", str(imu), "--port", str(gnss))
    with (
        emulator("g350", "nmea@4800", "--no-fix", "0.5", links=[imu, gnss]),
        daemon(tmp_path, *ports, "--set", "gnss.configure=true") as imud,
    ):
        imud.says("57600")
        imud.until(lambda m: m["class"] == "EST" and "position" in m["state"])
