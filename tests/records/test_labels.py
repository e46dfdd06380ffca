import pytest

from karolos.errors import RunError, UsageError
from karolos.records import labels
from karolos.records.labels import Labels


def test_tags_and_note_are_kept_and_changed(tmp_path):
    assert labels.read(tmp_path) == Labels()
    labels.add_tags(tmp_path, ["good", "a b", "good"])
    labels.set_note(tmp_path, "two\nlines <script>")
    labels.add_tags(tmp_path, ["best"])
    assert labels.read(tmp_path) == Labels(("a b", "best", "good"), "two\nlines <script>")
    labels.remove_tags(tmp_path, ["a b", "never there"])
    labels.set_note(tmp_path, "")
    assert labels.read(tmp_path) == Labels(("best", "good"), None)


@pytest.mark.parametrize("tag", ["", " ", " x", "x\n", "a\nb", "a\0b", "x" * 201, "\ud800"])
def test_text_that_is_no_tag_is_refused_and_changes_nothing(tmp_path, tag):
    with pytest.raises(UsageError, match="is not a tag; 1 to 200 characters"):
        labels.add_tags(tmp_path, ["good", tag])
    assert labels.read(tmp_path) == Labels()


def test_note_that_is_too_long_is_refused(tmp_path):
    with pytest.raises(UsageError, match="the note has 100,001 characters"):
        labels.set_note(tmp_path, "x" * 100_001)


@pytest.mark.parametrize("text", ['{"tags": ["go', '{"tags": ["b", 3], "note": null}', '{"tags": [], "note": 7}'])
def test_damaged_labels_are_not_written_over(tmp_path, text):
    (tmp_path / "labels.json").write_text(text)
    assert labels.is_damaged(tmp_path)
    assert labels.read(tmp_path) == Labels()
    with pytest.raises(RunError, match=r"labels\.json is damaged; repair it, or move it away"):
        labels.add_tags(tmp_path, ["x"])
    assert (tmp_path / "labels.json").read_text() == text
