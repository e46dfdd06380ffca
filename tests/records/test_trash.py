from pathlib import Path

import pytest
from support.run_samples import new_run, result

from karolos.errors import RunError, UsageError
from karolos.records import RunFolder, trash


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    with new_run(tmp_path, source=tmp_path) as folder:
        folder.add_test(result(10, 3))
        folder.set_state("finished", steps=10)
    return folder


def test_run_that_goes_on_stays(tmp_path):
    with new_run(tmp_path, source=tmp_path) as run, pytest.raises(RunError, match="another process is running it"):
        trash.throw_away(RunFolder.open(run.path))
    assert run.path.is_dir()


def test_run_that_is_there_again_is_not_replaced_and_kept_twice(run, tmp_path):
    first = trash.throw_away(run)
    with new_run(tmp_path, source=tmp_path) as second:
        pass
    second.path.rename(tmp_path / run.id)
    with pytest.raises(UsageError, match=f"there is a run {run.id} again"):
        trash.restore(first)
    again = trash.throw_away(RunFolder.open(tmp_path / run.id))
    assert {first.name, again.name} == {run.id, f"{run.id}-2"}
    assert trash.find(tmp_path, run.id) == first
    with pytest.raises(UsageError, match="'reach' means several runs in the trash"):
        trash.find(tmp_path, "reach")
    for nothing in ("", "x", "..", "../x"):
        with pytest.raises(UsageError, match=r"means no run in the trash; `karolos runs list --trash`"):
            trash.find(tmp_path, nothing)


def test_purge_removes_only_what_lies_in_the_trash(run, tmp_path):
    with pytest.raises(RunError, match="is not in the trash"):
        trash.purge(run.path)
    thrown = trash.throw_away(run)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "run.json").write_text("{}")
    (tmp_path / ".trash" / "link").symlink_to(elsewhere)
    with pytest.raises(RunError, match="is not in the trash"):
        trash.purge(tmp_path / ".trash" / "link")
    trash.purge(thrown)
    assert not thrown.exists()
    assert (elsewhere / "run.json").exists()
