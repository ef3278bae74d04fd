"""The multilayer perceptron under every trained flow."""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from splatmorph.errors import OptionError
from splatmorph.flows.jets import Activation, Jet
from splatmorph.flows.native import jet as native

ACTIVATIONS = ("sine", "sigmoid")


class Network(nn.Module):
    """Linear layers with an activation between them; sine makes it a SIREN (Sitzmann 2020).

    A sine layer is sin(ω(Wz + b)), with ``first_omega`` before the first and ``omega`` before the
    other activations. The last layer starts ``output_scale`` times its usual size and without a
    bias, so that a correction starts as nearly none.
    """

    def __init__(
        self,
        sizes: list[int],
        *,
        activation: str = "sine",
        first_omega: float = 24.0,
        omega: float = 6.0,
        output_scale: float = 0.1,
    ) -> None:
        super().__init__()
        if activation not in ACTIVATIONS:
            raise OptionError(
                f"activation '{activation}' is unknown: choose one of {', '.join(ACTIVATIONS)}"
            )
        self.activation = activation
        self.omegas = [first_omega] + [omega] * (len(sizes) - 3)
        self.output_scale = output_scale
        self.weights = nn.ParameterList(torch.zeros(b, a) for a, b in pairwise(sizes))
        self.biases = nn.ParameterList(torch.zeros(b) for b in sizes[1:])

    @torch.no_grad()
    def initialise(self, generator: torch.Generator) -> None:
        """Draw the weights anew: SIREN's bounds for sine, Glorot's for sigmoid."""
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            fan_out, fan_in = weight.shape
            last = layer == len(self.omegas)
            if self.activation == "sigmoid":
                bound = 4 * math.sqrt(6 / (fan_in + fan_out))
            elif layer == 0:
                bound = 1 / fan_in
            else:
                bound = math.sqrt(6 / fan_in) / self.omegas[-1]
            noise = torch.rand(fan_out, fan_in + 1, generator=generator) * 2 - 1
            weight.copy_(noise[:, :fan_in] * bound * (self.output_scale if last else 1))
            bias.copy_(noise[:, fan_in] * (0 if last else 1 / math.sqrt(fan_in)))

    def reset_parameters(self) -> None:
        """Draw the weights anew by torch's own generator, as its layers do."""
        self.initialise(torch.default_generator)

    def forward(self, x: Tensor) -> Tensor:
        """(m, in) -> (m, out), in the dtype of x."""
        for weight, bias, omega in zip(self.weights, self.biases, self.omegas, strict=False):
            z = linear(x, weight.to(x), bias.to(x))
            x = torch.sin(omega * z) if self.activation == "sine" else torch.sigmoid(z)
        return linear(x, self.weights[-1].to(x), self.biases[-1].to(x))

    def push(self, jet: Jet) -> Jet:
        """The same with derivatives.

        Where the network has fewer inputs than the jet has directions, it is differentiated in
        its inputs, and the chain rule does the rest on a few components instead of on every unit.
        """
        inputs = jet.value.shape[1]
        if len(jet.pairs) > inputs * (inputs + 1) // 2:
            return jet.then(self.push(Jet.seed(jet.value)))
        layers = self.layers()
        if native.takes("network", jet, layers):
            return native.push_network(jet, layers)
        x = jet.value
        for weight, bias, omega in zip(self.weights, self.biases, self.omegas, strict=False):
            jet = jet.linear(weight.to(x), bias.to(x)).activate(
                _sine(omega) if self.activation == "sine" else _sigmoid
            )
        return jet.linear(self.weights[-1].to(x), self.biases[-1].to(x))

    def layers(self) -> native.Layers:
        """What the C++ needs to know of it."""
        return native.Layers(self.activation, self.weights, self.biases, self.omegas)


def _sine(omega: float) -> Activation:
    def derivatives(z: Tensor, order: int) -> tuple[Tensor, ...]:
        z = omega * z
        g = torch.sin(z)
        return (g, omega * torch.cos(z), -(omega**2) * g)[: order + 1]

    return derivatives


def _sigmoid(z: Tensor, order: int) -> tuple[Tensor, ...]:
    g = torch.sigmoid(z)
    slope = g * (1 - g)
    return (g, slope, slope * (1 - 2 * g))[: order + 1]
