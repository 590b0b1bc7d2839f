"""Private words that docs/glossary.md replaced by the words of the field do not come back."""

import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("imud", "drivers", "firmware_sim")

# Words with no other meaning here: neither a name, nor a comment, nor a message may contain one.
ANYWHERE = (
    "strangeness", "disown", "give_in", "fitful", "look_after", "restless", "overlong", "let_in", "turn_away",
    "wander_azimuth", "drift_hypotheses", "farewell", "expel", "expelled", "blind_s", "stand_still",
    "fill_in", "hold_near", "hold_place",
)  # fmt: skip
# Words that plain English needs: no name in the code may be one of them.
NAMES = (
    "told", "telling", "wander", "absorb", "astray", "contrary", "creep", "creeping", "seemed", "witness", "manner",
    "shaking", "misfit", "look_at", "obey", "orders", "Inbox", "Door", "overhear", "hearing", "pass_on",
    "Tap", "Fitting", "Pace", "Account", "vitals", "Delivery", "LeftOut", "retire", "unseen_s",
    "hear", "patience_s", "Chatter", "stir", "gist", "Tape", "spell", "Spell", "neat", "oddities", "rivals", "UNTOLD",
    "complaint", "keep_apart", "Conversation", "noting", "way", "doubt", "strain", "slip", "hop", "owed", "feel",
    "says", "deaf", "nobody", "worth", "quiet", "story", "lively", "rubbish", "stranger",
    "heading_doubt", "doubt_field", "is_odd", "fever", "quietest", "spoilt", "insist", "looked_ns", "complaints",
    "jolt", "patience", "forget_tilt", "forget_rest", "forget_axis", "forget_sensor_errors", "late2", "reopen_biases",
    "turn_gain", "possible_error", "window_force", "room_for", "UNREAD", "OF_ONE", "AidingReceiver", "complains",
    "complained", "OF_SPARES", "Known",
)  # fmt: skip

# What is left. Delete an entry with its word; `test_no_exception_is_outdated` asks for it. Nothing may be added here.
ALLOWED: set[tuple[str, str]] = {
    ("imud/commands/metrics.py", "expelled"),
    ("imud/outputs/gpsd.py", "expelled"),
}


@cache
def words_of(path: Path) -> tuple[frozenset[str], frozenset[str]]:
    """The names in the code of a file, and all words in it."""
    text = path.read_text()
    names = {token.string for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type == 1}
    return frozenset(names), frozenset(re.findall(r"[A-Za-z_]\w*", text))


def left_behind() -> set[tuple[str, str]]:
    """(file, word) of each replaced word that stands in the code."""
    found = set()
    for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        names, words = words_of(path)
        stripped = {word.lstrip("_") for word in names}
        file = str(path.relative_to(ROOT))
        found |= {(file, word) for word in NAMES if word in stripped}
        found |= {(file, word) for word in ANYWHERE if word in words or f"_{word}" in words}
    return found


def test_no_replaced_word_comes_back():
    for file, word in sorted(left_behind() - ALLOWED):
        pytest.fail(f"{file}: {word!r} was replaced; docs/glossary.md says by what")


def test_no_exception_is_outdated():
    assert sorted(ALLOWED - left_behind()) == []
