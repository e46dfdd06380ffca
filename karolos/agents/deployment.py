"""From an agent's network and the statistics of its inputs to what is exported."""

from __future__ import annotations

from ..core.deployed import Deployed, Layer, Output
from .chain import EPSILON
from .inputs import to_array
from .networks import MLP
from .normaliser import Normaliser

ALL = slice(None)


def deployed(network: MLP, normaliser: Normaliser, output: Output, *, columns: slice = ALL) -> Deployed:
    """The network behind the normaliser, as copies on the CPU.

    Args:
        network: without members side by side.
        normaliser: of its inputs.
        output: what becomes of what it gives out.
        columns: of its output that matter.
    """
    parts = {name: to_array(part).copy() for name, part in network.named.items()}
    layers = [
        Layer(parts[f"layer{place}.weight"], parts[f"layer{place}.bias"].reshape(-1))
        for place in range(len(network.shape.sizes) - 1)
    ]
    last = layers.pop()
    layers.append(Layer(last.weight[columns], last.bias[columns]))
    shift, scale = (to_array(part).copy() for part in normaliser.terms)
    return Deployed(shift, scale, normaliser.clip, tuple(layers), output, EPSILON if network.shape.layer_norm else None)
