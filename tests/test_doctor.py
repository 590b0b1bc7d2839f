"""The doctor on machines imitated in folders."""

import subprocess
import sys
from pathlib import Path

import pytest
from processes import OBEYING

from imud.commands.doctor import examine


def machine(root: Path, files: dict[str, str]) -> list[str]:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return [f"{finding.grade}: {finding.what}" for finding in examine(root)]


def test_a_machine_without_ports(tmp_path):
    findings = machine(tmp_path, {"proc/cmdline": "quiet"})
    assert any(text.startswith("note: no serial port") for text in findings)
    assert not any(text.startswith("problem") for text in findings)


@pytest.mark.parametrize(
    ("files", "says"),
    [
        (
            {"proc/cmdline": "console=tty1 console=serial0,115200 root=/dev/x"},
            "note: the kernel's console is on serial0",
        ),
        (
            {"etc/systemd/system/getty.target.wants/serial-getty@ttyAMA0.service": ""},
            "note: a login prompt waits on ttyAMA0",
        ),
        (
            {"proc/cmdline": "console=ttyAMA0,115200", "etc/imud/imu.toml": 'ports = ["/dev/ttyAMA0:epson@460800"]'},
            "problem: the kernel's console is on ttyAMA0",
        ),
        (
            {"proc/cmdline": "console=ttyAMA0,115200", "etc/imud/imu.toml": 'ports = ["/dev/ttyUSB0"]'},
            "note: the kernel's console is on ttyAMA0",
        ),
        ({"proc/42/comm": "ModemManager\n"}, "note: ModemManager is running (pid 42)"),
        ({"sys/bus/usb-serial/devices/ttyUSB0/latency_timer": "16\n"}, "note: ttyUSB0 delivers bytes up to 16 ms late"),
        ({"boot/firmware/config.txt": "arm_64bit=1\n"}, "note: SPI is off"),
        ({"boot/firmware/config.txt": "arm_64bit=1\n", "dev/spidev0.0": ""}, "ok: SPI is on"),
        ({"dev/spidev0.0": ""}, "ok: /dev/spidev0.0 may be opened"),
        ({"dev/spidev0.0": "", "dev/gpiochip0": ""}, "ok: /dev/gpiochip0 may be opened"),
        ({"dev/ttyUSB0": ""}, "ok: /dev/ttyUSB0 may be opened"),
    ],
)
def test_each_obstacle_is_found(tmp_path, files, says):
    assert any(text.startswith(says) for text in machine(tmp_path, files))


def test_packages_for_spi_are_missed_only_where_there_is_spi(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert not any("package" in text for text in machine(tmp_path, {"dev/ttyUSB0": ""}))
    missed = [text for text in machine(tmp_path, {"dev/spidev0.0": ""}) if "package" in text]
    assert missed == [
        "note: the Python package spidev is missing, for SPI",
        "note: the Python package gpiod is missing, for a data-ready line",
    ]


def test_healthy_settings_are_not_complained_of(tmp_path):
    files = {
        "sys/bus/usb-serial/devices/ttyUSB0/latency_timer": "1\n",
        "proc/cmdline": "console=tty1",
        "proc/7/comm": "bash\n",
    }
    assert not any("late" in text or "console" in text or "running" in text for text in machine(tmp_path, files))


def test_a_port_without_permission_names_the_remedy(tmp_path):
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/ttyUSB0").write_text("")
    (tmp_path / "dev/ttyUSB0").chmod(0)
    code = """
import sys
from pathlib import Path
from imud.commands.doctor import examine
print(next(finding.remedy for finding in examine(Path(sys.argv[1])) if finding.grade == "problem"))
"""
    command = [*OBEYING, sys.executable, "-c", code, str(tmp_path)]
    remedy = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "usermod" in remedy or "chmod" in remedy


def test_two_names_of_one_device_are_one_port(tmp_path):
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/ttyAMA0").write_text("")
    (tmp_path / "dev/serial0").symlink_to("ttyAMA0")
    assert sum("may be opened" in finding.what for finding in examine(tmp_path)) == 1
