"""Every test that the documents' tables of faults name exists, and every fault has one."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
DOCS = TESTS.parent / "docs"
NAMED = re.compile(r"`(test_\w+\.py)(?:::(test_\w+))?`")
ROWS = [
    (document.name, cells[0].strip(), cells[2])
    for document in (DOCS / "faults.md", DOCS / "security.md")
    for line in document.read_text().splitlines()
    if len(cells := line.strip("| ").split("|")) == 3 and not set(line) <= set("|- ")
]


@cache
def functions_in(file):
    return {node.name for node in ast.parse((TESTS / file).read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize(("document", "fault", "tests"), [row for row in ROWS if row[2].strip() != "test"])
def test_every_fault_names_tests_that_exist(document, fault, tests):
    found = NAMED.findall(tests)
    assert found, f"{document}: {fault}"
    for file, name in found:
        assert (TESTS / file).is_file(), file
        assert not name or name in functions_in(file), f"{file}::{name}"


def test_the_tables_are_read():
    assert sum(document == "faults.md" for document, *_ in ROWS) > 30
    assert sum(document == "security.md" for document, *_ in ROWS) > 10
