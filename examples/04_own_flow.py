"""A flow of one's own is found by its kind, and trained: ``python 04_own_flow.py a.ply b.ply``."""

import sys

from torch import Tensor

import splatmorph as sm
from splatmorph.flows.base import as_column
from splatmorph.flows.network import Network
from splatmorph.flows.node import runge_kutta


class Small(sm.Flow):
    """The flow of dx/dt = v(x), v a network of one hidden layer."""

    kind = "small"

    def __init__(self, dim: int) -> None:
        super().__init__(dim)
        self.network = Network([dim, 32, 32, dim])

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        return runge_kutta(self.network, u, as_column(t, u), 2)


asked = sm.Fitting(flow="small", steps=60)
run = sm.fit_run(*sys.argv[1:3], out="small.run", fitting=asked, overwrite=True)
report = run.legs[0].report
print(f"mean square error {report['mse_before']:.1e} -> {report['mse']:.1e}")
