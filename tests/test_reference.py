"""The settings' reference: complete, true, and a file that is taken back."""

import re
import shutil
import subprocess
import tomllib

import msgspec
import pytest

from imud.commands import COMMANDS
from imud.commands.reference import man_command, man_configuration, sample, table, titles
from imud.configuration.schema import keys
from imud.configuration.settings import Settings
from imud.setup import config


def uncommented(text: str) -> str:
    return re.sub(r"^# (\w+ = )", r"\1", text, flags=re.M)


def test_every_key_and_table_is_described():
    undescribed = [key.path for key in keys() if len(key.what) < 10 or not key.what.endswith(".")]
    assert not undescribed
    assert set(titles()) == {key.table for key in keys()} - {""}


def test_the_sample_is_all_comments_with_the_defaults():
    assert config.loads(sample()) == Settings()
    chosen = config.loads(uncommented(sample()))
    assert msgspec.structs.replace(chosen, ports=()) == Settings()


def test_the_sample_holds_each_key_once():
    table = tomllib.loads(uncommented(sample()))
    flat = {f"{t}.{k}" for t, inner in table.items() if isinstance(inner, dict) for k in inner}
    flat |= {k for k, value in table.items() if not isinstance(value, dict)}
    assert flat == {key.path for key in keys()}


def test_a_sample_for_given_ports_names_them():
    assert config.loads(sample(["/dev/ttyS3:epson@460800"])).ports == ("/dev/ttyS3:epson@460800",)


def test_hot_keys_are_marked_in_every_form():
    hot = {key.path for key in keys() if key.hot}
    assert "gnss.max_hdop" in hot and "gpsd.listen" not in hot
    rows = [row.split(" | ") for row in re.sub(r"\\\|", "/", table()).splitlines()[2:]]
    assert {row[0].strip("|` ") for row in rows if row[3] == "✓"} == hot
    assert sample().count(". (hot)\n") == len(hot)
    assert man_configuration().count(", hot)") == len(hot)


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed (Debian: groff-base)")
@pytest.mark.parametrize("page", [man_command, man_configuration])
def test_man_pages_format_without_a_warning(page):
    command = ["groff", "-man", "-ww", "-Tutf8", "-Kutf8"]
    done = subprocess.run(command, check=False, input=page(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    text = re.sub(r"\x1b\[[\d;]*m|.\x08", "", done.stdout)
    words = [key.name for key in keys()] if page is man_configuration else list(COMMANDS)
    assert not [word for word in words if word not in text.replace("\n", " ").replace("‐ ", "")]


def test_the_man_page_has_the_values_that_an_option_may_have():
    assert "log\\-level debug|info|warning|error" in man_command()
