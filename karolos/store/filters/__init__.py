"""Filters over runs: `task=pick_place and agent.learning_rate<1e-3 and not state in (failed, lost)`.

    filter     = all ("or" all)*
    all        = one ("and" one)*
    one        = "not" one | "(" filter ")" | key operator value | key "in" "(" value ("," value)* ")"
    operator   = "=" | "!=" | "<" | "<=" | ">" | ">=" | "~"
    value      = number | true | false | null | word | "text in quotes"

A comparison with a value that a run does not have is false, except that with `= null`; `!=` is `not =`. `~` says that
a text contains another, in upper or lower case. Of the tags any may fit. Numbers are compared as numbers, texts as
texts (times are ISO 8601, which sorts like time), one with the other never. Nothing is evaluated but this.
"""

from .filter import LONGEST, Filter, parse
from .grammar import DEEPEST

__all__ = ["DEEPEST", "LONGEST", "Filter", "parse"]
