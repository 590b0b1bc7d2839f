"""What mypy knows of the filters' records is what they are."""

import ast

import pytest
import record_types

MOST_UNTYPED_PERCENT = 5.0
DECORATORS = {"kernel", "unrolled"}


@pytest.mark.parametrize("path", record_types.FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_the_types_are_those_of_the_dtypes(path):
    assert path.read_text() == record_types.text(path), "`python tests/record_types.py` writes the files anew"


def test_a_field_is_a_number_an_array_or_a_record():
    ins = record_types.text(record_types.IMUD / "estimators" / "ins" / "types.py")
    assert "class Nav:\n    t_ns: int\n    fused_count: int\n" in ins
    assert "class Core:\n    nav: Nav\n" in ins


def arguments_of_kernels():
    """What is written as the type of each argument of each kernel."""
    folders = record_types.IMUD, record_types.IMUD.parent / "drivers"
    for path in {path.resolve() for folder in folders for path in folder.rglob("*.py")}:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and DECORATORS & {ast.unparse(name) for name in node.decorator_list}:
                yield from (ast.unparse(argument.annotation) for argument in node.args.args)


def test_kernels_say_which_records_they_take():
    arguments = list(arguments_of_kernels())
    assert len(arguments) > 1000
    assert 100.0 * arguments.count("Any") / len(arguments) <= MOST_UNTYPED_PERCENT
