"""Orthogonal weights (Saxe et al. 2014): what on-policy agents start from."""

from __future__ import annotations

import torch

from .networks import MLP

RECTIFIER_GAIN = 2**0.5
"""Keeps the size of signals through rectifiers. Source: He et al. 2015."""


def make_orthogonal(network: MLP, generator: torch.Generator, *, last_gain: float) -> None:
    """Give a network orthogonal weights and no biases.

    Args:
        network: one without members.
        generator: draws the weights, on the CPU.
        last_gain: of the last layer, where others have sqrt(2); a small one makes the outputs start near 0.
    """
    weights = {name: view for name, view in network.named.items() if name.endswith("weight")}
    network.vector.zero_()
    for number, view in enumerate(weights.values(), 1):
        drawn = torch.empty(view.shape)
        gain = last_gain if number == len(weights) else RECTIFIER_GAIN
        view.copy_(torch.nn.init.orthogonal_(drawn, gain, generator=generator))
