import pytest

from roadsight.base.errors import InputError, nearest


@pytest.mark.parametrize(
    ("message", "details", "told"),
    [
        (
            "slope is too steep",
            {"where": "site a", "found": 3, "allowed": "at most 2", "hint": "lower it"},
            "site a: slope is too steep; found 3; allowed: at most 2; lower it.",
        ),
        ("no points.", {}, "no points."),
        ("no points; ", {"hint": "check the file."}, "no points; check the file."),
        ("no 'slop'", {"hint": nearest("slop", ["slope"])}, "no 'slop'; did you mean 'slope'?"),
        ("too few", {"found": 0, "allowed": "1"}, "too few; found 0; allowed: 1."),
        ("wrong", {"found": False}, "wrong; found False."),
    ],
)
def test_a_message_is_one_sentence_with_its_details_in_order(message, details, told):
    assert str(InputError(message, **details)) == told


def test_nearest_names_the_closest_word_or_all_in_order():
    assert nearest("slop", ["slope", "pillar_width_m"]) == "did you mean 'slope'?"
    assert nearest("xyz", ["b", "a"]) == "valid names: a, b"


def test_a_message_stays_short_whatever_would_be_allowed():
    message = str(InputError("too many cells", allowed="x" * 5000))
    assert len(message) < 1100
