"""The manual and the README are true: imud takes their commands, and settings, files, links, messages exist."""

import ast
import contextlib
import importlib
import io
import os
import re
import shlex
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

from imud import client
from imud.commands import COMMANDS, arguments_of
from imud.configuration.schema import keys
from imud.outputs.gpsd_json import STATUS_NAMES
from imud.setup import config

ROOT = Path(__file__).resolve().parents[1]
MANUAL = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [ROOT / "README.md", *MANUAL]
READMES = [ROOT / folder / "README.md" for folder in ("drivers", "imud", "imud/estimators", "imud/outputs", "tests")]
LINKING = [*PAGES, *READMES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
SETTINGS = {key.path for key in keys()}
TABLES = {key.table for key in keys()} - {""}
PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))


def blocks(page, language):
    """The fenced blocks of a language, without their indentation."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^\1```", page.read_text(), flags=re.M | re.S)
    return ["\n".join(line.removeprefix(indent) for line in text.splitlines()) for indent, text in found]


def commands(page):
    """The words of each call of imud in the page's shell blocks."""
    for line in "\n".join(blocks(page, "sh")).splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars="();<>|&")
        lexer.whitespace_split = True
        words, before = [*lexer, ";"], ""
        while words:
            end = next(i for i, word in enumerate(words) if set(word) <= set("();<>|&"))
            call, written = words[:end], before in (">", "<")
            before, words = words[end], words[end + 1 :]
            while call and (call[0] in ("sudo", "PYTHONPATH") or "=" in call[0]):
                call = call[1:]
            if call and not written and Path(call[0]).name == "imud":
                yield call[1:]


def check(call):
    """Parse a call as `imud` does, with its settings. Raises AssertionError with imud's own message."""
    name, *arguments = ["run", *call] if call[0].startswith("-") else call
    assert name in COMMANDS, f"no command {name}"
    message = io.StringIO()
    try:
        with contextlib.redirect_stderr(message):
            args = arguments_of(name).parse_args(arguments)
    except SystemExit:
        raise AssertionError(message.getvalue()) from None
    if getattr(args, "set", None):
        config.load(None, args.set)


@PAGE
def test_every_command_is_one_that_imud_takes(page):
    for call in commands(page):
        check(call)


@pytest.mark.parametrize(
    "call", ["relpay x.mcap", "replay --smoothly x.mcap -o y", "--port sim:car --set navigation.lever_arm=[0,0,0]"]
)
def test_a_command_that_imud_does_not_take_is_noticed(call):
    with pytest.raises((AssertionError, config.ConfigError)):
        check(shlex.split(call))


def test_the_commands_of_the_manual_are_found():
    assert {call[0] for page in PAGES for call in commands(page) if not call[0].startswith("-")} >= {
        *("calibrate", "demo", "doctor", "export", "install-service", "probe", "record", "reference", "replay"),
        *("report", "sensor", "sim", "status", "web"),
    }


@PAGE
def test_every_configuration_is_one_that_imud_takes(page):
    for text in blocks(page, "toml"):
        config.loads(text)


@PAGE
def test_every_setting_that_is_named_exists(page):
    for code in re.findall(r"`([^`\n]+)`", page.read_text()):
        name = re.split(" ?=", code)[0]
        if re.fullmatch(rf"({'|'.join(TABLES)})\.(?!(csv|mcap|conf|py|md)$)[a-z][a-z_0-9]*", name):
            assert name in SETTINGS, name


def anchors(page):
    """Those of its headings, as GitHub and mkdocs make them."""
    headings = re.findall(r"^#+ (.*)", page.read_text(), flags=re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", LINKING, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_to_a_heading_of_it(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        target, _, anchor = link.partition("#")
        if not re.match(r"[a-z]+:", link):
            there = page.parent / target if target else page
            assert there.exists(), link
            assert not anchor or anchor in anchors(there), link


@PAGE
def test_every_file_that_is_named_exists(page):
    for name in re.findall(r"`((?:imud|drivers|firmware_sim|tests|docs|systemd)/[\w./-]+)`", page.read_text()):
        assert (ROOT / name).exists() or name == "imud/compile/kernels.so", name
    for name in re.findall(r"`(test_\w+\.py)`", page.read_text()):
        assert (ROOT / "tests" / name).exists(), name


def test_every_section_of_the_protocols_that_is_cited_exists():
    sections = set(re.findall(r"^###? ([\d.]+)[. ]", (ROOT / "docs/protocols.md").read_text(), flags=re.M))
    cited = set()
    for path in (
        path for folder in ("imud", "drivers", "firmware_sim", "tests") for path in (ROOT / folder).rglob("*.py")
    ):
        cited |= set(re.findall(r"protocols\.md,? §?(\d(?:\.\d)?)", path.read_text()))
    assert {"1.5", "2", "3", "4.1"} <= cited
    assert cited <= {section.rstrip(".") for section in sections}


@PAGE
def test_every_python_block_uses_what_there_is(page):
    for text in blocks(page, "python"):
        tree = ast.parse(text)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "imud":
                module = importlib.import_module(node.module)
                assert all(hasattr(module, alias.name) for alias in node.names), text
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "imud":
                assert hasattr(importlib.import_module("imud"), node.attr), text


@cache
def texts():
    """Every string in the sources; `…` where a value is inserted."""
    found = []
    for folder in ("imud", "drivers"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.JoinedStr):
                    parts = (str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
                    found.append("".join(parts))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.append(node.value)
    return found


def is_printed(message):
    """Whether the program has a string with all parts of the message, in this order."""
    pattern = ".*".join(re.escape(part) for part in message.split("…"))
    return any(re.search(pattern, text, flags=re.S) for text in texts())


MESSAGES = re.findall(r"^\| `([^`]+)` \|", (ROOT / "docs/troubleshooting.md").read_text(), flags=re.M)


@pytest.mark.thorough
@pytest.mark.parametrize("message", MESSAGES)
def test_every_message_of_the_manual_is_one_that_imud_prints(message):
    assert is_printed(message)


def test_a_message_that_imud_does_not_print_is_noticed():
    assert len(MESSAGES) > 30
    assert not is_printed("there is … wrong with the sensor, of all things")


def table(page, heading):
    """The rows of the first table behind a heading."""
    text = (ROOT / "docs" / page).read_text().partition(heading)[2].partition("\n## ")[0]
    rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in text.splitlines() if line[:1] == "|"]
    return [tuple(cell.strip("| `") for cell in row) for row in rows[2:]]


def test_the_status_bits_are_those_of_the_program():
    assert {(int(bit), name, word) for bit, name, word, _ in table("interfaces.md", "## Status bits")} == {
        (bit, name, STATUS_NAMES[bit]) for name, bit in client.STATUS.items()
    }


def test_the_records_fields_are_those_of_the_program():
    kinds = [(name, f"{kind}[{count}]" if count > 1 else kind) for name, kind, count, _ in client.FIELDS]
    assert [row[:2] for row in table("interfaces.md", "## Binary stream")] == kinds


def test_the_columns_of_the_manual_are_those_of_est_csv():
    from imud.tables.estimates import ESTIMATE_HEADER

    listed = ",".join(row[0] for row in table("interfaces.md", "## `est.csv`"))
    assert listed.split(",") == ESTIMATE_HEADER.split(",")


@pytest.mark.thorough
def test_the_manual_is_built_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="pip install 'imud[docs]'")
    pytest.importorskip("material", reason="pip install 'imud[docs]'")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "-q",
        "-f",
        ROOT / ".mkdocs.yml",
        "-d",
        tmp_path / "site",
    ]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(list((tmp_path / "site").rglob("index.html"))) == len(MANUAL)


def test_the_extra_brings_what_the_manual_is_built_with():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert [re.match(r"[\w-]+", name)[0] for name in extras["docs"]] == ["mkdocs-material"]
