"""Settings as parameters: the text of the value, told apart by the name."""

from __future__ import annotations

import shlex

from roadsight.config.load import NamedValue


def test_swapped_values_are_another_set_of_parameters() -> None:
    before = {repr(NamedValue("a.spacing_m", 8.0)), repr(NamedValue("a.step_m", 2.0))}
    after = {repr(NamedValue("a.spacing_m", 2.0)), repr(NamedValue("a.step_m", 8.0))}
    assert before != after
    assert repr(NamedValue("a", 1)) == repr(NamedValue("a", 1))


def test_on_a_command_line_it_is_the_value() -> None:
    assert f"{NamedValue('a.b', 2.5)}" == "2.5"
    assert f"--classes {NamedValue('a.b', [11, 17])}" == "--classes 11 17"
    assert shlex.quote(NamedValue("a.b", "two words")) == "'two words'"
    assert NamedValue("a.b", "") == ""
