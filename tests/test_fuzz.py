"""Every surface with its corpus, and for a moment with changed inputs; `python tests/fuzz.py` goes on for hours."""

import random

import pytest
from fuzz import changed, failure, inputs_of
from fuzz_surfaces import SURFACES, Surface
from hypothesis import given
from hypothesis import strategies as st


@pytest.mark.thorough
@pytest.mark.parametrize("name", SURFACES)
def test_the_corpus_raises_nothing(name):
    for data in inputs_of(name):
        assert not failure(SURFACES[name], data), data


@pytest.mark.thorough
@pytest.mark.parametrize("name", SURFACES)
def test_changed_inputs_raise_nothing(name):
    chance, inputs, surface = random.Random(1), inputs_of(name), SURFACES[name]
    for _ in range(surface.tries):
        data = changed(chance.choice(inputs), inputs, surface.words, chance)
        assert not failure(surface, data), data


@given(st.sampled_from(sorted(SURFACES)), st.binary(max_size=200))
def test_any_bytes_raise_nothing(name, data):
    assert not failure(SURFACES[name], data), (name, data)


def test_a_surface_that_raises_is_a_failure():
    def take(data):
        raise OverflowError("int too large")

    assert "OverflowError" in failure(Surface(take, (b"",)), b"")


@given(st.binary(max_size=50), st.integers())
def test_a_change_can_be_repeated_by_its_seed(data, seed):
    once, again = (changed(data, [data, b"x"], (b"a",), random.Random(seed)) for _ in range(2))
    assert once == again
