"""One clear message for bad input."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

# Letters of a foreign text that a message quotes: enough to recognise it, not a whole file.
_LONGEST = 500
# Letters of what would be allowed: columns of a damaged file may go on for pages.
_LONGEST_LIST = 1000


class InputError(Exception):
    """Bad input, told in one message: where, what was found, what is allowed, what to do next.

    Parameters
    ----------
    problem : what is wrong, one sentence.
    where : site, file or field that holds the value.
    found : the value found.
    allowed : what would have been accepted.
    hint : what to do next.
    """

    def __init__(
        self,
        problem: str,
        *,
        where: str = "",
        found: object = None,
        allowed: object = None,
        hint: str = "",
    ) -> None:
        parts = [_on_one_line(f"{where}: {problem}" if where else problem)]
        if found is not None:
            parts.append(f"found {_on_one_line(found)}")
        if allowed is not None:
            parts.append(f"allowed: {_on_one_line(allowed, _LONGEST_LIST)}")
        if hint:
            parts.append(hint)
        message = "; ".join(part.rstrip(".; ") for part in parts)
        super().__init__(message if message.endswith("?") else message + ".")


def _on_one_line(text: object, longest: int = _LONGEST) -> str:
    """Text of a file or of another program, made fit for a message: short, nothing unprintable."""
    plain = " ".join(str(text).split())
    plain = "".join(letter if letter.isprintable() else "?" for letter in plain)
    return plain if len(plain) <= longest else f"{plain[:longest]}..."


def unreadable(what: str, path: object, problem: object) -> InputError:
    """Message that a file of the workflow, which makes it again once it is gone, is damaged."""
    return InputError(
        f"cannot be read as {what} ({problem})",
        where=str(path),
        hint="delete it and run the workflow again",
    )


def nearest(name: str, valid: Iterable[str]) -> str:
    """Hint that names the valid word closest to ``name``, or lists them all."""
    valid = sorted(valid)
    close = difflib.get_close_matches(name, valid, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"valid names: {', '.join(valid)}"
