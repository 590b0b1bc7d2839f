"""What mypy knows of the navigation filter's records is what they are."""

import record_types


def test_the_types_are_those_of_the_dtypes():
    assert record_types.FILE.read_text() == record_types.text()


def test_a_field_is_a_number_an_array_or_a_record():
    assert "class Nav:\n    t_ns: int\n    fused_count: int\n" in record_types.text()
    assert "class Core:\n    nav: Nav\n" in record_types.text()
