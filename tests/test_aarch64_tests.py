"""The tests that are not run under qemu are tests that there are."""

from pathlib import Path

import pytest
from aarch64_tests import LEFT_OUT


@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_is_left_out_under_qemu_exists(name):
    file, _, function = name.partition("::")
    assert f"\ndef {function}(" in Path(__file__).with_name(file).read_text()
