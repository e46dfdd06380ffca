"""A network that treats all joints of an arm alike, so that one policy moves arms with any number of joints.

A first layer is computed of each joint's columns and the others, and summed over the joints, as in Zaheer et al. 2017,
"Deep Sets"; a perceptron follows. In a policy a last layer gives each joint's outputs, of its columns and of what the
perceptron says. Both layers also multiply linear functions: how far a joint shall turn is a product of where the tool
shall go and how the joint moves it, and rectifiers need many units for a product.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..core import Deployed, JointLayers, Layer
from . import layers
from .layers import Affine, Tape
from .networks import MLP, NetworkShape, array_of, take


@dataclass(frozen=True)
class JointShape(NetworkShape):
    """Columns and units of a network for s joints.

    Args:
        sizes: input columns, h units of the layers that joints share, units of the perceptron's hidden layers, outputs.
        joints: the k input columns of each joint, (s, k). The g other inputs are those of the arm.
        each: the output columns of each joint, (s, e). e = 0: all outputs are the perceptron's.
    """

    joints: tuple[tuple[int, ...], ...] = ()
    each: tuple[tuple[int, ...], ...] = ()

    def parameters(self) -> dict[str, tuple[int, int]]:
        k, e, (inputs, h, *hidden, outputs) = len(self.joints[0]), len(self.each[0]), self.sizes
        g, context = inputs - k * len(self.joints), 2 * h if e else 0
        shapes = {"joint.weight": (3 * h + context, k), "joint.bias": (1, 3 * h), "others.weight": (2 * h, g)}
        for number, (before, after) in enumerate(
            pairwise((2 * h + g, *hidden, context + outputs - e * len(self.each)))
        ):
            shapes[f"layer{number}.weight"], shapes[f"layer{number}.bias"] = (after, before), (1, after)
        return shapes | ({"each.weight": (e, 2 * h), "each.bias": (1, e)} if e else {})


class JointTape(NamedTuple):
    """The values of a forward pass that the backward pass needs."""

    joints: Tensor
    """Their columns, (n, s, k)."""
    others: Tensor
    """(n, g)"""
    linear: Tensor
    """The linear functions of each joint: rectified, two factors, then those of the last layer: (n, s, 3 h or 5 h)."""
    context: Tensor
    """Outputs of the perceptron: what it says to the last layer, (n, 2 h), and outputs of the network."""
    perceptron: Tape

    def rows(self, first: int) -> JointTape:
        """The tape of the rows from `first` on."""
        joints, others, linear, context, perceptron = self
        return JointTape(joints[first:], others[first:], linear[first:], context[first:], perceptron.rows(first))


class JointNetwork(MLP):
    """The network of this module. It computes in float32.

    Args:
        generator: draws the weights, on the CPU: uniform in +- 1 / sqrt(input columns).
    """

    shape: JointShape

    def __init__(self, shape: JointShape, generator: torch.Generator, device: str) -> None:
        self.shape, members = shape, max(shape.members, 1)
        self.vector = torch.zeros(members * sum(map(math.prod, shape.parameters().values())), device=device)
        self.gradient = torch.zeros_like(self.vector)
        self._table = self.vector.view(members, -1)
        self._parts, self._part_gradients = (
            [
                {name: view[member] for name, view in self._views(vector.view(members, -1)).items()}
                for member in range(members)
            ]
            for vector in (self.vector, self.gradient)
        )
        fan_in = 1
        for name, part in self._views(self._table).items():
            fan_in = part.shape[-1] if name.endswith("weight") else fan_in
            part.copy_((torch.rand(part.shape, generator=generator) * 2 - 1) / fan_in**0.5)

        def others(count: int, table: tuple[tuple[int, ...], ...]) -> list[int]:
            used = {column for row in table for column in row}
            return [column for column in range(count) if column not in used]

        columns = shape.joints, others(shape.sizes[0], shape.joints), shape.each, others(shape.sizes[-1], shape.each)
        self._joints, self._others, self._each, self._rest = (
            torch.tensor(one, dtype=torch.int64, device=device) for one in columns
        )

    def forward(self, x: Tensor, *, exact: bool = False, members: int | None = None) -> tuple[Tensor, list[Any]]:  # noqa: ARG002
        joints, others = x[:, self._joints], x[:, self._others]
        passes = [self._forward(views, joints, others) for views in self._parts[:members]]
        outputs = torch.stack([output for output, _ in passes]) if self.shape.members else passes[0][0]
        return outputs, [tape for _, tape in passes]

    def _forward(self, p: dict[str, Tensor], joints: Tensor, others: Tensor) -> tuple[Tensor, JointTape]:
        (n, s, _), h = joints.shape, self.shape.sizes[1]
        linear = (joints.flatten(0, 1) @ p["joint.weight"].mT).view(n, s, -1)
        linear[..., : 3 * h] += p["joint.bias"]
        linear[..., : 2 * h] += (others @ p["others.weight"].mT).unsqueeze(1)
        rectified, first, second = linear[..., : 3 * h].chunk(3, 2)
        summed = torch.cat((rectified.relu().sum(1), torch.linalg.vecdot(first, second, dim=1)), 1) / s**0.5
        inputs = torch.cat((summed, others), 1)
        context, perceptron = layers.forward(inputs, _layers(p), layer_norm=self.shape.layer_norm)
        tape = JointTape(joints, others, linear, context, perceptron)
        if not self._each.numel():
            return context, tape
        each = torch.addmm(p["each.bias"], self._last_hidden(tape).flatten(0, 1), p["each.weight"].mT)
        outputs = context.new_empty((n, self.shape.sizes[-1]))
        outputs[:, self._each], outputs[:, self._rest] = each.view(n, s, -1), context[:, 2 * h :]
        return outputs, tape

    def _last_hidden(self, tape: JointTape) -> Tensor:
        """What each joint's outputs are linear functions of: (n, s, 2 h)."""
        h = self.shape.sizes[1]
        rectified, first = tape.linear[..., 3 * h :].chunk(2, 2)
        added, second = tape.context[:, None, : 2 * h].chunk(2, 2)
        return torch.cat(((rectified + added).relu(), first * second), 2)

    def backward(
        self, gradient: Tensor, tapes: Sequence[Any], *, parameters: bool = True, columns: slice | None = None
    ) -> Tensor | None:
        total: Tensor | None = None
        for member, tape in enumerate(tapes):
            own = gradient[member] if self.shape.members else gradient
            out = self._part_gradients[member] if parameters else None
            by_linear, by_others = self._backward(self._parts[member], own, tape, out)
            if columns is None:
                continue
            by_input = own.new_zeros((len(own), self.shape.sizes[0]))
            weight = self._parts[member]["joint.weight"]
            by_input[:, self._joints] = (weight.mT @ by_linear.flatten(0, 1).mT).mT.reshape(
                len(own), *self._joints.shape
            )
            by_input[:, self._others] = by_others
            total = by_input[:, columns] if total is None else total.add_(by_input[:, columns])
        return total

    def _backward(
        self, p: dict[str, Tensor], gradient: Tensor, tape: JointTape, out: dict[str, Tensor] | None
    ) -> tuple[Tensor, Tensor]:
        """The gradients by the linear functions of the joints and by the other inputs; those by parameters to `out`."""
        (n, s, _), h, linear = tape.joints.shape, self.shape.sizes[1], tape.linear
        by_linear, by_context = torch.empty_like(linear), gradient
        if self._each.numel():
            each, hidden = gradient[:, self._each].flatten(0, 1), self._last_hidden(tape)
            if out is not None:
                torch.mm(each.mT, hidden.flatten(0, 1), out=out["each.weight"])
                torch.sum(each, 0, keepdim=True, out=out["each.bias"])
            by_rectified, by_product = (each @ p["each.weight"]).view(n, s, -1).chunk(2, 2)
            by_rectified = torch.mul(by_rectified, hidden[..., :h] > 0, out=by_linear[..., 3 * h : 4 * h])
            torch.mul(by_product, tape.context[:, None, h : 2 * h], out=by_linear[..., 4 * h :])
            by_second = torch.linalg.vecdot(by_product, linear[..., 4 * h :], dim=1)
            by_context = torch.cat((by_rectified.sum(1), by_second, gradient[:, self._rest]), 1)
        by_inputs = layers.backward(
            by_context, tape.perceptron, _layers(p), out=None if out is None else _layers(out), columns=slice(None)
        )
        assert by_inputs is not None
        by_rectified, by_product = (by_inputs[:, None, : 2 * h] / s**0.5).chunk(2, 2)
        torch.mul(by_rectified, linear[..., :h] > 0, out=by_linear[..., :h])
        torch.mul(by_product, linear[..., 2 * h : 3 * h], out=by_linear[..., h : 2 * h])
        torch.mul(by_product, linear[..., h : 2 * h], out=by_linear[..., 2 * h : 3 * h])
        summed = by_linear.sum(1)
        if out is not None:
            # MKL multiplies few rows with a matrix five times as fast as a matrix with few columns.
            out["joint.weight"].copy_((tape.joints.flatten(0, 1).mT @ by_linear.flatten(0, 1)).mT)
            torch.sum(summed[:, : 3 * h], 0, keepdim=True, out=out["joint.bias"])
            torch.mm(summed[:, : 2 * h].mT, tape.others, out=out["others.weight"])
        return by_linear, by_inputs[:, 2 * h :] + summed[:, : 2 * h] @ p["others.weight"]

    def arrays(self, columns: slice) -> tuple[list[Layer], JointLayers | None]:
        p, k, h, kept = self._parts[0], self._joints.shape[1], self.shape.sizes[1], range(self.shape.sizes[-1])[columns]
        first = p["joint.weight"].new_zeros((5 * h, k + len(self._others)))
        first[:, :k], first[: 2 * h, k:] = p["joint.weight"], p["others.weight"]
        first_bias = torch.nn.functional.pad(p["joint.bias"][0], (0, 2 * h))
        each = [[column for column in row if column in kept] for row in self.shape.each]
        rest = [column for column in self._rest.tolist() if column in kept]
        hidden = [Layer(array_of(weight), array_of(bias)) for weight, bias in _layers(p)]
        said = 2 * h + len(rest)
        hidden[-1] = Layer(hidden[-1].weight[:said], hidden[-1].bias[:said])
        last = Layer(array_of(p["each.weight"])[: len(each[0])], array_of(p["each.bias"])[0, : len(each[0])])
        places = np.argsort([*chain(*each), *rest])
        own, shared = (array_of(table) for table in (self._joints, self._others))
        return hidden, JointLayers(own, shared, places, Layer(array_of(first), array_of(first_bias)), last)

    def adopt(self, policy: Deployed) -> None:
        p, k, h, joints = self._parts[0], self._joints.shape[1], self.shape.sizes[1], policy.joints
        assert joints is not None
        p["joint.weight"].copy_(torch.from_numpy(joints.first.weight[:, :k]))
        p["others.weight"].copy_(torch.from_numpy(joints.first.weight[: 2 * h, k:]))
        p["joint.bias"].copy_(torch.from_numpy(joints.first.bias[: 3 * h]))
        for own, layer in zip(_layers(p), policy.layers, strict=True):
            take(own, layer)
        take(Affine(p["each.weight"], p["each.bias"][0]), joints.last)


def _layers(parameters: dict[str, Tensor]) -> list[Affine]:
    """The layers of the perceptron."""
    count = sum(name.startswith("layer") for name in parameters) // 2
    return [
        Affine(parameters[f"layer{number}.weight"], parameters[f"layer{number}.bias"][0]) for number in range(count)
    ]
