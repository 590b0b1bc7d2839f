"""Private words that the words of the field (`docs/glossary.md`) have replaced do not come back."""

import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("imud", "drivers", "firmware_sim")

# What to write: the private words that it replaced. They mean nothing else here: no name, comment or message has one.
ANYWHERE = {
    "max_nis": "strangeness",
    "disable_nhc": "disown",
    "reset_to_gnss": "give_in",
    "max_rate_of_change": "fitful",
    "tick, check": "look_after",
    "drift_detected": "restless",
    "too_long": "overlong",
    "accept, reject, disconnect": "let_in turn_away farewell expel expelled",
    "frame_azimuth": "wander_azimuth",
    "hypothesis_bank": "drift_hypotheses",
    "outage_s": "blind_s",
    "extrapolate_gap": "fill_in",
    "pseudo_measurement, fuse_zupt": "stand_still hold_near hold_place",
}
# The same for words that plain English needs: no name in the code is one of them.
NAMES = {
    "pending_innovations, innovation_count": "told telling",
    "gnss_bias": "wander",
    "gated_update": "absorb",
    "heading_fault_count": "astray",
    "velocity_reject_count": "contrary",
    "gnss_drift_fault": "creep creeping seemed",
    "motion_class, vibration_level, low_motion_count": "manner shaking quiet lively",
    "residual_energy, accumulate_integrals": "misfit feel witness",
    "covariance_inflation, inflate_covariance": "doubt heading_doubt doubt_field",
    "nhc_lateral, nhc_vertical, nhc_innovation_sum": "slip hop strain",
    "deferred_rotation": "owed",
    "reset_*": "forget_tilt forget_rest forget_axis forget_sensor_errors reopen_biases",
    "rotate_gain": "turn_gain",
    "second_difference": "jolt",
    "needed_s, timeout_s": "patience patience_s",
    "possible_tilt_error, window_delta_v": "possible_error window_force",
    "age, time_offset_var": "late2",
    "is_wrong, bad_temperature_count, noise": "is_odd fever quietest spoilt",
    "outage_s, last_data_ns": "unseen_s looked_ns",
    "innovation_buffer, PENDING_MAX, PER_MEASUREMENT_MAX": "room_for UNREAD OF_ONE",
    "update, check": "look_at",
    "handle_command, commands": "obey orders",
    "messages": "news",
    "publish, forward": "pass_on",
    "StatusReporter, status_tables, Publisher": "Account vitals Delivery",
    "fault_texts, warning, warnings_of, reported_faults": "complaint complaints oddities complains complained",
    "ReceiveBuffer, Listeners": "Inbox Door",
    "ByteSink, Recording": "Tap Tape",
    "EstimatorSelection": "Fitting",
    "SampleRateMonitor": "Pace",
    "SkippedRows": "LeftOut",
    "release": "retire",
    "received, receive, signatures": "hear hearing overhear deaf",
    "UnrecognisedData, summary, rank, Activity": "Chatter gist worth stir rubbish stranger",
    "Interval": "spell Spell",
    "competing_programs, holders": "rivals",
    "UNUSABLE": "UNTOLD",
    "refuse_overwriting": "keep_apart",
    "DialogueRunner": "Conversation",
    "recording_entries": "noting",
    "ned_difference, description": "way story",
    "DatagramDecoder": "AidingReceiver",
    "KnownDevice, SPARE_ESTIMATOR": "Known OF_SPARES",
    "a word of the field": "says nobody neat insist",
}

# What is left. Delete an entry with its word; `test_no_exception_is_outdated` asks for it. Nothing may be added here.
ALLOWED: set[tuple[str, str]] = {
    ("imud/commands/status/metrics.py", "expelled"),
    ("imud/outputs/gpsd.py", "expelled"),
}


@cache
def words_of(path: Path) -> frozenset[str]:
    """All words in a file."""
    return frozenset(re.findall(r"[A-Za-z_]\w*", path.read_text()))


@cache
def names_of(path: Path) -> frozenset[str]:
    """The names in the code of a file, without the underscores that they begin with."""
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text()).readline)
    return frozenset(token.string.lstrip("_") for token in tokens if token.type == tokenize.NAME)


def by_word(table: dict[str, str]) -> dict[str, str]:
    """Each replaced word, and what to write."""
    return {word: instead for instead, words in table.items() for word in words.split()}


def left_behind() -> set[tuple[str, str]]:
    """(file, word) of each replaced word that stands in the code."""
    found = set()
    for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        words = words_of(path)
        possible = by_word(NAMES).keys() & {word.lstrip("_") for word in words}
        file = str(path.relative_to(ROOT))
        found |= {(file, word) for word in possible if word in names_of(path)}
        found |= {(file, word) for word in by_word(ANYWHERE) if word in words or f"_{word}" in words}
    return found


def test_no_replaced_word_comes_back():
    for file, word in sorted(left_behind() - ALLOWED):
        pytest.fail(f"{file}: instead of {word!r} write {(by_word(ANYWHERE) | by_word(NAMES))[word]}")


def test_no_exception_is_outdated():
    assert sorted(ALLOWED - left_behind()) == []
