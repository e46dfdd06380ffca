"""Device, threads and precision of an agent's computations."""

from __future__ import annotations

from typing import Literal

import torch

from ..errors import MachineError

Precision = Literal["auto", "float32", "bfloat16"]
PRECISION_MEANS = (
    "of matrix products while learning; sums, inputs and outputs stay float32. auto: bfloat16 on a CPU that has "
    "instructions for it (AMX, AVX-512 BF16), else float32"
)


def resolve_device(name: str) -> str:
    """The device that `auto`, `cpu` or `cuda` means on this machine.

    Raises:
        MachineError: `cuda` without a CUDA device.
    """
    if name == "cpu":
        return "cpu"
    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise MachineError(
            "torch finds no CUDA device on this machine",
            setting="training.device",
            hint="set training.device=cpu or auto",
        )
    return "cuda" if available else "cpu"


def use_threads(count: int) -> None:
    """Compute with `count` threads in this process. More threads than free cores slow every update down."""
    torch.set_num_threads(count)


def uses_bfloat16(precision: Precision, device: str | torch.device) -> bool:
    """Whether hidden layers compute in bfloat16. `auto` chooses it on an x86 CPU with instructions for it.

    Other CPUs emulate bfloat16, which is slower than float32. On a GPU products of this size wait for their launches.
    """
    if precision != "auto":
        return precision == "bfloat16"
    if torch.device(device).type != "cpu":
        return False
    capabilities: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))
