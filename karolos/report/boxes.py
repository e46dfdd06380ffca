"""Box plots side by side, as a picture file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import MachineError, UsageError

FORMATS = (".svg", ".png", ".pdf")


@dataclass(frozen=True)
class Panel:
    """One set of axes: for each label the values of its box."""

    title: str
    across: str
    up: str
    values: Mapping[str, Sequence[float]]


def check_format(path: Path) -> None:
    """Raise a UsageError unless the file's ending names a picture format: before anything is measured for it."""
    if path.suffix not in FORMATS:
        raise UsageError(f"{path.name} names no picture", hint=f"let it end in {', '.join(FORMATS)}")


def draw_boxes(panels: Sequence[Panel], path: Path) -> None:
    """Write the panels beside each other into `path`, in the format that its ending names.

    Raises:
        UsageError: no picture format.
        MachineError: the file cannot be written.
    """
    check_format(path)
    from matplotlib.figure import Figure  # noqa: PLC0415  (takes a second)

    figure = Figure(figsize=(5 * len(panels), 4), layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        axes.boxplot(list(panel.values.values()), tick_labels=list(panel.values))
        axes.set_title(panel.title)
        axes.set_xlabel(panel.across)
        axes.set_ylabel(panel.up)
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", alpha=0.3)
    try:
        figure.savefig(path)
    except OSError as error:
        raise MachineError(f"the figure cannot be written: {error.strerror}", where=str(path)) from error
