"""Installing the service: what is shown is what is done, and nothing that the user owns is lost."""

import subprocess
import sys
from pathlib import Path

import pytest

from imud.commands import install_service, main
from imud.commands.install_service import Remove, Run, Write, _program
from imud.setup import config

FILES = {
    "etc/systemd/system/imud@.service",
    "etc/sysusers.d/imud.conf",
    "etc/udev/rules.d/60-imud.rules",
    "usr/local/share/man/man1/imud.1",
    "usr/local/share/man/man5/imud.toml.5",
    "etc/imud/front.toml",
}
INSTALL = ["install-service", "front", "--yes", "--root"]


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


def test_into_an_image(tmp_path, capsys):
    assert main([*INSTALL, str(tmp_path), "--port", "/dev/ttyUSB0"]) == 0
    assert files(tmp_path) == FILES
    assert config.load(tmp_path / "etc/imud/front.toml").ports == ("/dev/ttyUSB0",)
    shown = capsys.readouterr().out
    assert all(f"write  {tmp_path / name}" in shown for name in FILES)
    assert "run " not in shown
    assert f"systemctl --root={tmp_path} enable imud@front" in shown


def test_a_second_time_changes_nothing(tmp_path, capsys):
    main([*INSTALL, str(tmp_path)])
    mine = tmp_path / "etc/imud/front.toml"
    mine.write_text('ports = ["/dev/ttyS9"]\n')
    capsys.readouterr()
    assert main([*INSTALL, str(tmp_path)]) == 0
    assert mine.read_text() == 'ports = ["/dev/ttyS9"]\n'
    assert "write" not in capsys.readouterr().out


def test_a_port_for_a_service_that_is_configured_already_is_refused(tmp_path, capsys):
    main([*INSTALL, str(tmp_path)])
    assert main([*INSTALL, str(tmp_path), "--port", "/dev/ttyUSB1"]) == 78
    assert "front.toml is there already" in capsys.readouterr().err


def test_dry_run_touches_nothing(tmp_path, capsys):
    assert main([*INSTALL, str(tmp_path), "--dry-run", "--realtime"]) == 0
    assert files(tmp_path) == set()
    assert "imud@.service.d/realtime.conf" in capsys.readouterr().out


def test_without_a_terminal_nothing_is_asked(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", open("/dev/null"))  # noqa: SIM115, PTH123
    assert main(["install-service", "front", "--root", str(tmp_path)]) == 64
    assert "--yes" in capsys.readouterr().err
    assert files(tmp_path) == set()


def test_removal_keeps_configurations_and_what_another_instance_needs(tmp_path):
    main([*INSTALL, str(tmp_path), "--realtime"])
    wants = tmp_path / "etc/systemd/system/multi-user.target.wants"
    wants.mkdir()
    (wants / "imud@rear.service").symlink_to("../imud@.service")
    main([*INSTALL, str(tmp_path), "--remove"])
    assert "etc/systemd/system/imud@.service" in files(tmp_path)
    (wants / "imud@rear.service").unlink()
    main([*INSTALL, str(tmp_path), "--remove"])
    assert files(tmp_path) == {"etc/imud/front.toml"}


def test_on_this_machine_the_commands_follow_the_files(monkeypatch):
    monkeypatch.setattr(install_service, "_program", lambda root: Path("/opt/imud/bin/imud"))
    parser = __import__("argparse").ArgumentParser()
    install_service.add_arguments(parser)
    with pytest.raises(install_service.UsageError, match="--port"):
        install_service.installation(parser.parse_args(["front"]))  # it would end at once: no port
    steps = install_service.installation(parser.parse_args(["front", "--port", "/dev/ttyUSB0"]))
    kinds = [type(step) for step in steps]
    assert kinds == sorted(kinds, key=[Write, Run].index)
    commands = [step.command for step in steps if isinstance(step, Run)]
    assert commands[-2:] == [("systemctl", "enable", "imud@front"), ("systemctl", "restart", "imud@front")]
    removal = install_service.removal(Path("/"), "front")
    assert removal[0] == Run(("systemctl", "disable", "--now", "imud@front"), optional=True)
    assert all(isinstance(step, Remove | Run) for step in removal)


def test_the_unit_calls_the_imud_that_installs_it(monkeypatch, tmp_path):
    program = tmp_path / "bin/imud"
    program.parent.mkdir()
    program.touch()
    monkeypatch.setattr(sys, "executable", str(program.with_name("python")))
    assert _program(Path("/")) == program
    program.unlink()
    with pytest.raises(install_service.InputMissingError, match="install imud with pip"):
        _program(Path("/"))


@pytest.mark.parametrize("place", ["/home/pi/venv/bin/python", "/root/venv/bin/python"])
def test_a_program_that_the_service_could_not_read_is_refused(monkeypatch, place):
    monkeypatch.setattr(sys, "executable", place)
    monkeypatch.setattr(Path, "exists", lambda self: True)
    with pytest.raises(install_service.InputMissingError, match="/opt/imud"):
        _program(Path("/"))


def test_a_bad_name_is_refused(capsys):
    assert main(["install-service", "a/b", "--dry-run"]) == 64


def test_a_failing_command_is_named():
    with pytest.raises(install_service.ImudError, match="`false` failed with 1"):
        Run(("false",)).execute()
    with pytest.raises(install_service.ImudError, match="no no-such-command"):
        Run(("no-such-command",)).execute()
    Run(("no-such-command",), optional=True).execute()


@pytest.mark.skipif(not Path("/usr/bin/systemd-sysusers").exists(), reason="systemd is not installed")
def test_the_groups_file_is_understood(tmp_path):
    main([*INSTALL, str(tmp_path)])
    command = ["systemd-sysusers", "--dry-run", str(tmp_path / "etc/sysusers.d/imud.conf")]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0 and "ignoring" not in done.stderr
