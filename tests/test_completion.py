"""Shell completion as bash itself does it, and hints for what was mistyped."""

import re
import shutil
import subprocess

import pytest

from imud.commands import COMMANDS, main

COMPLETE = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
function=$(complete -p imud); function=${function#*-F }; ${function%% *}
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    pytest.importorskip("shtab", reason="pip install 'imud[completion]'")
    path = tmp_path_factory.mktemp("completion") / "imud"
    with pytest.MonkeyPatch.context() as patch, path.open("w") as file:
        patch.setattr("sys.stdout", file)
        assert main(["completion", "bash"]) == 0
    return path


@pytest.mark.parametrize(
    ("words", "completions"),
    [
        (["rep"], {"replay", "report", "reproduce"}),
        (["--por"], {"--port"}),  # of `run`, the default
        (["replay", "--in"], {"--initial", "--innovations"}),
        (["reproduce", ""], {"farrell", "suh", "prasanna"}),
        (["run", "--log-level", "wa"], {"warning"}),
        (["replay", "dri"], {"drive.mcap"}),
    ],
)
def test_bash_completes(words, completions, script, tmp_path):
    (tmp_path / "drive.mcap").touch()
    bash = [shutil.which("bash"), "-c", COMPLETE, "bash", script, "imud", *words]
    done = subprocess.run(bash, check=True, cwd=tmp_path, capture_output=True, text=True)
    assert (set(done.stdout.split()), done.stderr) == (completions, "")


def test_zsh_gets_every_command(capsys):
    pytest.importorskip("shtab", reason="pip install 'imud[completion]'")
    assert main(["completion", "zsh"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("#compdef imud")
    assert not [name for name in COMMANDS if not re.search(rf"\n    [\"']?{name}:", text)]  # as its version quotes


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["relpay", "x.mcap"], "there is no command 'relpay'; did you mean replay?"),
        (["xyzzy"], "there is no command 'xyzzy'; there are run, demo,"),
        (["replay", "x.mcap", "-o", "y", "--inovations=z"], "did you mean --innovations?"),
        (["--prot", "/dev/ttyUSB0"], "did you mean --port?"),
        (["replay", "x.mcap", "-o", "y", "--innov", "z"], "did you mean --innovations?"),
        (["run", "--qqq"], "unrecognized arguments: --qqq\n"),
    ],
)
def test_a_mistyped_word_brings_what_may_have_been_meant(arguments, hint, capsys):
    with pytest.raises(SystemExit) as misuse:
        main(arguments)
    assert misuse.value.code == 64
    assert hint in capsys.readouterr().err


def test_a_mistyped_setting_brings_what_may_have_been_meant(capsys):
    assert main(["run", "--check", "--port", "sim:car", "--set", "navigation.lever_arm=[0,0,0]"]) == 78
    assert "did you mean navigation.lever_arm_m?" in capsys.readouterr().err
