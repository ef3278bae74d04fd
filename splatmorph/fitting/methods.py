"""How each kind of flow is fitted: an open registry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from splatmorph.fitting.objectives import (
    IfmorphObjective,
    NCFObjective,
    PaperObjective,
    SirenObjective,
)
from splatmorph.fitting.solve import solve_displacement, solve_spline
from splatmorph.fitting.task import Task
from splatmorph.flows import (
    NCF,
    Flow,
    Ifmorph,
    Linear,
    Node,
    SirenField,
    SplineField,
    ThinPlate,
)

AnyFlow = TypeVar("AnyFlow", bound=Flow)
Method = Callable[[AnyFlow, Task], bool]
"""Fits a flow in place; False where the user interrupted it and the best so far is kept."""

_METHODS: dict[type[Flow], Method[Any]] = {}


def fitted_by(kind: type[AnyFlow]) -> Callable[[Method[AnyFlow]], Method[AnyFlow]]:
    """Say how flows of the class ``kind``, and of those that inherit from it, are fitted.

        @fitted_by(MyFlow)
        def solve(flow: MyFlow, task: Task) -> bool:
            flow.shift.copy_((task.q - task.p).mean(0))
            return True

    A flow of which nothing is said is trained on the paper's objective.
    """

    def register(method: Method[AnyFlow]) -> Method[AnyFlow]:
        _METHODS[kind] = method
        return method

    return register


def method_of(flow: Flow) -> Method[Any]:
    """How ``flow`` is fitted: as its class says, or the nearest that it inherits from."""
    return next(_METHODS[kind] for kind in type(flow).__mro__ if kind in _METHODS)


@fitted_by(Flow)
def _train(flow: Flow, task: Task) -> bool:
    return task.train(PaperObjective(flow, task))


@fitted_by(Node)
def _fit_node(flow: Node, task: Task) -> bool:
    if isinstance(flow.field, SplineField):
        solve_spline(flow.field, task.p, task.q, task.config, task.record)
        return True
    if isinstance(flow.field, SirenField):
        return task.train(SirenObjective(flow, task))
    return _train(flow, task)


@fitted_by(NCF)
def _fit_ncf(flow: NCF, task: Task) -> bool:
    return task.train(NCFObjective(flow, task))


@fitted_by(Ifmorph)
def _fit_ifmorph(flow: Ifmorph, task: Task) -> bool:
    return task.train(IfmorphObjective(flow, task))


@fitted_by(ThinPlate)
def _fit_thin_plate(flow: ThinPlate, task: Task) -> bool:
    solve_displacement(flow, task.p, task.q, task.config)
    return True


@fitted_by(Linear)
def _fit_linear(flow: Linear, task: Task) -> bool:
    return True
