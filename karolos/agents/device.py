"""Where tensors live and how many cores compute them."""

from __future__ import annotations

import torch

from ..errors import MachineError


def resolve_device(name: str) -> str:
    """The device that `auto`, `cpu` or `cuda` means on this machine.

    Raises:
        MachineError: `cuda` is asked for and there is none.
    """
    if name == "cpu":
        return "cpu"
    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise MachineError(
            "training.device is cuda, and this machine has no CUDA device that torch can use",
            hint="set training.device=cpu or auto",
        )
    return "cuda" if available else "cpu"


def use_threads(count: int) -> None:
    """Compute with `count` threads in this process; more than the cores that are free slows every update down."""
    torch.set_num_threads(count)
