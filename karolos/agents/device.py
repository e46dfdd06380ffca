"""Where tensors live and how many cores compute them."""

from __future__ import annotations

from typing import Literal

import torch

from ..errors import MachineError

Precision = Literal["auto", "float32", "bfloat16"]
PRECISION_MEANS = (
    "of the wide products while learning; sums, inputs and outputs stay float32. auto: bfloat16 on a CPU that computes "
    "in it (AMX, AVX-512 BF16), else float32"
)


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


def synchronise(device: str) -> None:
    """Wait until the device has computed everything it was given; at once on a CPU."""
    if device != "cpu":
        torch.cuda.synchronize(device)


def is_low(precision: Precision, device: str | torch.device) -> bool:
    """Whether wide products are computed in bfloat16. `auto` does so where it pays: an x86 CPU made for it.

    Elsewhere bfloat16 is emulated and slower than float32; on a GPU products of this size wait for their launches.
    """
    if precision != "auto":
        return precision == "bfloat16"
    if torch.device(device).type != "cpu":
        return False
    found: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(found.get("avx512_bf16") or found.get("amx_bf16"))
