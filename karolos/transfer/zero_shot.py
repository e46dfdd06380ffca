"""The zero-shot tests of a matrix as a job of the driver: each is a folder that says what to play."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from typing_extensions import override

from .. import system
from ..evaluation.zero_shot import ZeroShotTest
from ..experiment.events import RunEvent
from ..files import write_json
from ..launchers.driver import FolderTask, Job
from ..launchers.interface import LAUNCH, STOP
from ..records import provenance
from ..records.evaluation import Evaluation


@dataclass(eq=False)
class ZeroShotJob(Job):
    """Zero-shot tests that are not played twice.

    Args:
        tests: folder -> test. A folder exists only while its test is played.
        heard: is called with each test's folder and its result or, if it has none, the reason.
    """

    tests: Mapping[Path, ZeroShotTest]
    heard: Callable[[Path, Evaluation | None, str | None], None]

    @override
    def tasks(self) -> Iterator[FolderTask]:
        for folder, test in self.tests.items():
            if (known := test.result()) is not None:
                self.heard(folder, known, None)
            else:
                yield _ZeroShotTask(self, folder, test)


@dataclass(eq=False)
class _ZeroShotTask(FolderTask):
    job: ZeroShotJob
    folder: Path
    test: ZeroShotTest

    @override
    def begin(self) -> Path:
        self.test.write(self.folder)
        system.remove(self.folder / STOP, missing_ok=True)  # of an earlier process
        write_json(self.folder / LAUNCH, provenance.software())
        return self.folder

    @override
    def is_over(self) -> bool:
        return self.test.result() is not None

    @override
    def end(self, problem: str | None) -> Iterator[RunEvent]:
        system.remove_tree(self.folder)
        with suppress(OSError):
            self.folder.parent.rmdir()  # of the last one
        result = self.test.result()
        if result is not None or not self.job.halted:
            self.job.heard(self.folder, result, None if result else problem or "it has no result")
        yield from ()
