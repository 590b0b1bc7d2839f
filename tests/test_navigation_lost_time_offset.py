"""A time offset beyond the fusion horizon would reject all fixes for ever: it is wrong, and found anew."""

from accuracy_simulated import figures

REPEATS_ARE_USED = {"repeated_s": 0.02}


def test_after_a_time_offset_that_no_receiver_has_the_fixes_are_used_again():
    """A multicopter whose receiver repeats positions, which the filter is made to use: they look like a delay."""
    run = lambda tuning: figures("multicopter", "RTK", 0.0, 1300, tuning, error="held")  # noqa: E731
    assert run(REPEATS_ARE_USED | {"lost_time_offset_s": 100.0})["position m"] > 100.0
    row = run(REPEATS_ARE_USED)
    assert row["position m"] < 2.0
    assert row["position s"] < 3.0
