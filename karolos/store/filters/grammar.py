"""From tokens to conditions, by recursive descent; the grammar stands in the package's own text."""

from __future__ import annotations

from .conditions import All, Comparison, Either, Literal, Node, Not
from .tokens import Token, number, refuse, tokens, unquoted

DEEPEST = 50
"""Levels of parentheses and nots: far below what Python's stack holds."""
_OPERATORS = "= != < <= > >= ~ in"
_WORDS: dict[str, bool | None] = {"true": True, "false": False, "null": None, "none": None}


class Parser:
    """Recursive descent over the tokens of a filter."""

    def __init__(self, text: str) -> None:
        self._tokens = [*tokens(text), Token("end", "", len(text.rstrip()) + 1)]
        self._at = 0
        self._depth = 0

    def read(self) -> Node:
        node = self._either()
        if self._next.kind != "end":
            refuse(f"{self._next.text!r} does not belong here", self._next.column, "go on with and, or; or end")
        return node

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    def _take(self) -> Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _takes(self, word: str) -> bool:
        token = self._next
        found = token.kind != "text" and token.text.lower() == word
        self._at += found
        return found

    def _either(self) -> Node:
        parts = [self._all()]
        while self._takes("or"):
            parts.append(self._all())
        return parts[0] if len(parts) == 1 else Either(tuple(parts))

    def _all(self) -> Node:
        parts = [self._one()]
        while self._takes("and"):
            parts.append(self._one())
        return parts[0] if len(parts) == 1 else All(tuple(parts))

    def _one(self) -> Node:
        self._depth += 1
        if self._depth > DEEPEST:
            refuse("too many levels", self._next.column, f"up to {DEEPEST} parentheses and nots may lie in each other")
        if self._takes("not"):
            node: Node = Not(self._one())
        elif self._takes("("):
            node = self._either()
            self._expect(")")
        else:
            node = self._comparison()
        self._depth -= 1
        return node

    def _comparison(self) -> Node:
        key = self._take()
        if key.kind not in {"word", "text"} or (key.kind == "word" and key.text.lower() in {"and", "or", "in"}):
            refuse(f"{key.text or 'the end'!r} is no key", key.column, "e.g. task=reach, or agent.learning_rate<1e-3")
        name = unquoted(key)
        if self._takes("in"):
            return Comparison(name, "in", self._list(), key.column)
        if self._next.text.lower() == "not" and self._tokens[self._at + 1].text.lower() == "in":
            self._at += 2
            return Not(Comparison(name, "in", self._list(), key.column))
        operator = self._take()
        if operator.kind != "sign" or operator.text not in _OPERATORS.split():
            refuse(f"{operator.text or 'the end'!r} is no comparison", operator.column, f"there are {_OPERATORS}")
        return Comparison(name, operator.text, (self._literal(),), key.column)

    def _list(self) -> tuple[Literal, ...]:
        end = "]" if self._takes("[") else ")"
        if end == ")":
            self._expect("(")
        literals = [self._literal()]
        while self._takes(","):
            literals.append(self._literal())
        self._expect(end)
        return tuple(literals)

    def _literal(self) -> Literal:
        token = self._take()
        if token.kind == "text":
            return Literal(unquoted(token), unquoted(token))
        if token.kind != "word":
            refuse(f"{token.text or 'the end'!r} is no value", token.column, 'a number, a word or a "text in quotes"')
        if token.text.lower() in _WORDS:
            return Literal(token.text, _WORDS[token.text.lower()])
        return Literal(token.text, number(token.text))

    def _expect(self, sign: str) -> None:
        if not self._takes(sign):
            refuse(f"a {sign} is missing", self._next.column, f"before {self._next.text or 'the end'!r}")
