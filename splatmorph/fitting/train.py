"""Training: Adam on an objective, the best model by the true metric, resumable."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from splatmorph.errors import NonFiniteError, OptionError
from splatmorph.fitting.report import SMOOTHING, FitConfig, FitState
from splatmorph.fitting.solve import Record

CHECK_EVERY = 20
"""Steps between two looks at the true metric."""
PATIENCE = 10
"""Looks without a better one, in the last quarter, before training stops."""
STALLED = 0.1
"""A run that keeps more than this part of the landmark error has collapsed and is begun anew."""
ATTEMPTS = 3


@dataclass(frozen=True)
class Recipe:
    """How a kind of flow is trained."""

    steps: int
    learning_rate: float
    samples: int
    """Points a step at which the energy is sampled."""
    weight_start: float
    weight_end: float
    """Of the energy against the landmarks; annealed geometrically from the one to the other."""

    def weight(self, step: int, steps: int, smoothing: float) -> float:
        """The energy's weight in a step; its end is in proportion to ``smoothing``."""
        end = self.weight_end * max(smoothing / SMOOTHING, 1e-3)
        start = max(self.weight_start, end)
        return float(start * (end / start) ** (step / steps))

    def rate(self, step: int, steps: int) -> float:
        """The learning rate in a step: ten steps of warming up, then half a cosine down."""
        cosine = 0.5 * (1 + math.cos(math.pi * step / steps))
        return self.learning_rate * min(1.0, (step + 1) / 10) * (cosine + 1e-3)


class Objective(Protocol):
    """What is trained, and on what."""

    recipe: Recipe

    @property
    def module(self) -> nn.Module:
        """The flow, whose whole state is kept."""

    def initialise(self, seed: int) -> list[nn.Parameter]:
        """Begin anew; the parameters to train."""

    def loss(self, weight: float, generator: torch.Generator) -> Tensor:
        """Landmark term plus ``weight`` times the energy, sampled by ``generator``."""

    def mse(self) -> float:
        """The true metric: mean squared landmark error a coordinate, finely integrated."""

    def finish(self) -> None:
        """What is done to the best model after training."""


def train(
    objective: Objective,
    config: FitConfig,
    record: Record,
    resume: FitState | None = None,
    on_state: Callable[[FitState], None] | None = None,
) -> bool:
    """Train in place and keep the best model seen; False where the user interrupted it.

    Raises ``NonFiniteError`` where every attempt blew up.
    """
    objective.initialise(config.seed)
    before = objective.mse()
    best: dict[str, Tensor] = {}
    best_mse = math.inf
    for attempt in range(ATTEMPTS):
        run = _Attempt(objective, config, attempt)
        if resume is not None:
            run.restore(resume)
            resume = None
        try:
            finished = run.go(record, on_state)
        finally:
            if run.best_mse < best_mse:
                best, best_mse = run.best, run.best_mse
            if best:
                objective.module.load_state_dict(best)
        if not finished or best_mse < STALLED * before or best_mse < config.tolerance:
            break
    if not math.isfinite(best_mse):
        raise NonFiniteError(
            f"training became NaN or infinite in each of {ATTEMPTS} attempts: look for landmarks "
            "that contradict each other, or raise the smoothing"
        )
    objective.finish()
    record(run.step, run.step, objective.mse())
    return finished


class _Attempt:
    def __init__(self, objective: Objective, config: FitConfig, attempt: int) -> None:
        self.objective = objective
        self.config = config
        self.begin(attempt)

    def begin(self, attempt: int) -> None:
        self.attempt = attempt
        seed = self.config.seed + 1000 * attempt
        self.parameters = self.objective.initialise(seed)
        self.generator = torch.Generator().manual_seed(seed)
        self.optimizer = torch.optim.Adam(self.parameters, betas=(0.9, 0.99), foreach=True)
        self.step = 0
        self.best: dict[str, Tensor] = {}
        self.best_mse = math.inf
        self.best_step = 0

    def go(self, record: Record, on_state: Callable[[FitState], None] | None) -> bool:
        steps = self.config.steps or self.objective.recipe.steps
        for parameter in self.parameters:
            parameter.requires_grad_(True)
        try:
            while self.step < steps:
                if not self._advance(steps):
                    return True
                if self.step % CHECK_EVERY == 0 or self.step == steps:
                    mse = self._look()
                    record(self.step, steps, mse)
                    if on_state is not None:
                        on_state(self.state())
                    waited = (self.step - self.best_step) // CHECK_EVERY
                    if mse < self.config.tolerance or (
                        waited >= PATIENCE and self.step > steps * 3 // 4
                    ):
                        return True
        except KeyboardInterrupt:
            if not self.best:
                self._look()
            return False
        finally:
            for parameter in self.parameters:
                parameter.requires_grad_(False)
                parameter.grad = None
        return True

    def _advance(self, steps: int) -> bool:
        recipe = self.objective.recipe
        for group in self.optimizer.param_groups:
            group["lr"] = recipe.rate(self.step, steps) * 0.5**self.attempt
        weight = recipe.weight(self.step, steps, self.config.bending)
        if self.config.energy == "none":
            weight = 0.0
        loss = self.objective.loss(weight, self.generator)
        if not torch.isfinite(loss):
            return False
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters, 1.0, foreach=True)
        self.optimizer.step()
        self.step += 1
        return True

    @torch.no_grad()
    def _look(self) -> float:
        mse = self.objective.mse()
        if mse < self.best_mse:
            self.best_mse, self.best_step = mse, self.step
            state = self.objective.module.state_dict()
            self.best = {name: value.clone() for name, value in state.items()}
        return mse

    def state(self) -> FitState:
        tensors = {"generator": self.generator.get_state()}
        for name, value in self.objective.module.state_dict().items():
            tensors[f"flow.{name}"] = value.clone()
        for name, value in self.best.items():
            tensors[f"best.{name}"] = value
        for i, parameter in enumerate(self.parameters):
            for name, value in self.optimizer.state[parameter].items():
                tensors[f"adam.{i}.{name}"] = value.clone()
        meta = {
            "attempt": str(self.attempt),
            "step": str(self.step),
            "best_step": str(self.best_step),
            "best_mse": repr(self.best_mse),
        }
        return FitState(tensors, meta)

    @torch.no_grad()
    def restore(self, state: FitState) -> None:
        try:
            attempt, step, best_step = (
                int(state.meta[name]) for name in ("attempt", "step", "best_step")
            )
            if not (0 <= attempt < ATTEMPTS and 0 <= best_step <= step):
                raise ValueError("steps that no training takes")
            self.begin(attempt)
            self.step, self.best_step = step, best_step
            self.best_mse = float(state.meta["best_mse"])
            weights = self.objective.module.state_dict()
            self.best = _under("best.", state.tensors, weights) or {}
            if self.best:
                self.objective.module.load_state_dict(self.best)
                if not math.isfinite(self.objective.mse()):
                    raise ValueError("its best carries landmarks to infinity")
            self.objective.module.load_state_dict(_under("flow.", state.tensors, weights) or {})
            for i, parameter in enumerate(self.parameters):
                moments = dict.fromkeys(("exp_avg", "exp_avg_sq"), parameter)
                like = {"step": torch.zeros(()), **moments}
                kept = _under(f"adam.{i}.", state.tensors, like)
                if kept is not None:
                    kept["step"].fill_(step)
                    self.optimizer.state[parameter] = kept
            self.generator.set_state(state.tensors["generator"])
        except (ArithmeticError, LookupError, ValueError, TypeError, RuntimeError) as error:
            raise OptionError(
                f"{state.origin} is of another flow or version ({error}): fit anew"
            ) from error


def _under(
    prefix: str, tensors: Mapping[str, Tensor], like: Mapping[str, Tensor]
) -> dict[str, Tensor] | None:
    """What is kept under ``prefix``, of the names, shapes and types of ``like``; None: nothing is.

    Raises ``ValueError``.
    """
    found = {k.removeprefix(prefix): v.clone() for k, v in tensors.items() if k.startswith(prefix)}
    if not found:
        return None
    if found.keys() != like.keys():
        raise ValueError(f"{', '.join(found)} instead of {', '.join(like)}")
    for name, value in found.items():
        if value.shape != like[name].shape or value.dtype != like[name].dtype:
            raise ValueError(f"{prefix}{name} has another shape or type")
    return found
