from __future__ import annotations

from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from karolos.report.markup import Markup, tag


class Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.texts: list[str] = []
        self.values: list[str | None] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.values += [value for _, value in attrs]

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@given(st.text(st.characters(categories=("L", "N", "P", "S")), min_size=1), st.text("<>&\"'/= abc"))
def test_text_and_attribute_come_back_as_they_were(text: str, value: str) -> None:
    reader = Reader()
    reader.feed(tag("p", text, title=value))
    reader.close()
    assert reader.tags == ["p"]
    assert "".join(reader.texts) == text
    assert reader.values == [value]


def test_markup_inside_markup_is_not_escaped_again() -> None:
    assert tag("b", tag("i", "<"), " & ") == "<b><i>&lt;</i> &amp; </b>"
    assert tag("p", Markup("<hr>"), "<hr>") == "<p><hr>&lt;hr&gt;</p>"


def test_nothing_is_left_out_and_zero_is_something() -> None:
    assert tag("input", None, checked=True, disabled=False, value=0, name=None) == '<input checked value="0"/>'
    assert tag("td", 0, False, None) == "<td>0</td>"


def test_attributes_are_spelt_as_in_html() -> None:
    assert tag("meta", http_equiv="x", class_="y") == '<meta http-equiv="x" class="y"/>'


def test_signs_that_steer_are_replaced() -> None:
    assert tag("p", "a\x1b[2J\u202eb\nc") == "<p>a\ufffd[2J\ufffdb\nc</p>"
