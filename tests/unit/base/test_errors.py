from roadsight.base.errors import InputError, nearest


def test_message_tells_where_what_found_allowed_and_hint_in_this_order():
    error = InputError(
        "slope is too steep", where="site a", found=3, allowed="at most 2", hint="lower it"
    )
    assert str(error) == "site a: slope is too steep; found 3; allowed: at most 2; lower it."


def test_message_without_details_is_one_sentence_with_one_full_stop():
    assert str(InputError("no points.")) == "no points."
    assert str(InputError("no points; ", hint="check the file.")) == "no points; check the file."


def test_a_question_needs_no_full_stop():
    assert str(InputError("unknown key 'slop'", hint=nearest("slop", ["slope"]))) == (
        "unknown key 'slop'; did you mean 'slope'?"
    )


def test_falsy_values_found_are_still_told():
    assert "found 0;" in str(InputError("too few", found=0, allowed="at least 1"))
    assert "found False" in str(InputError("wrong", found=False))


def test_nearest_names_the_closest_word():
    assert nearest("slop", ["slope", "pillar_width_m"]) == "did you mean 'slope'?"


def test_nearest_lists_all_words_in_order_when_none_is_close():
    assert nearest("xyz", ["b", "a"]) == "valid names: a, b"


def test_a_message_stays_short_whatever_would_be_allowed():
    message = str(InputError("too many cells", allowed="x" * 5000))
    assert len(message) < 1100
