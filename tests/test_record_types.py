"""What mypy knows of the filters' records is what they are."""

import pytest
import record_types


@pytest.mark.parametrize("path", record_types.FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_the_types_are_those_of_the_dtypes(path):
    assert path.read_text() == record_types.text(path)


def test_a_field_is_a_number_an_array_or_a_record():
    ins = record_types.text(record_types.IMUD / "estimators" / "ins" / "types.py")
    assert "class Nav:\n    t_ns: int\n    fused_count: int\n" in ins
    assert "class Core:\n    nav: Nav\n" in ins
