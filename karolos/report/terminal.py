"""Text that comes from files, made safe for a terminal."""

from __future__ import annotations


def clean(text: object) -> str:
    """A text as it may reach a terminal: on one line, control characters replaced.

    What is left cannot move the cursor, change colours or ring; nor can bidirectional marks reorder the line.
    """
    return "".join(sign if sign.isprintable() else "\N{REPLACEMENT CHARACTER}" for sign in str(text))
