"""A fit gives the same bits on one core as on many."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from splatmorph.flows import FIELDS, KINDS

ROOT = Path(__file__).parents[2]

FITS = """
import hashlib, os
if "ONE_CORE" in os.environ:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import torch
from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import FIELDS, KINDS, make_flow
from splatmorph.geometry.alignment import similarity_between
from splatmorph.landmarks import Landmarks

def points(count, dim, seed):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, dim, generator=generator, dtype=torch.float64) - 0.5

def show(name, *tensors):
    bits = b"".join(tensor.contiguous().numpy().tobytes() for tensor in tensors)
    print(name, hashlib.sha256(bits).hexdigest())

p = points(400, 3, 0)
q = p + 0.1 * torch.sin(3 * p.roll(1, 1)) + 1e-3 * points(400, 3, 1)
frame = similarity_between(p, q)
show("frame", frame.rotation, frame.shift)
for kind in sorted(KINDS):
    for options in [{"field": field} for field in FIELDS] if kind == "node" else [{}]:
        flow = make_flow(kind, **options)
        domain = points(1000, 3, 2)
        report = fit(flow, Landmarks(p), Landmarks(q), FitConfig(steps=7), domain=domain)
        show("-".join([kind, *options.values()]), *flow.state_dict().values())
        print(kind, repr(report.mse), repr(report.det_min), repr(report.energy_second))
print(torch.get_num_threads())
"""


def fits(**environment: str) -> list[str]:
    """A line for each kind of flow, and the threads that torch has in the end."""
    done = subprocess.run(
        [sys.executable, "-c", FITS],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.splitlines()


def test_the_bits_are_the_same_on_one_core_and_on_many() -> None:
    *one, threads_of_one = fits(OMP_NUM_THREADS="1")
    *two, threads_of_two = fits(OMP_NUM_THREADS="2")
    assert (threads_of_one, threads_of_two) == ("1", "2")
    ours = [kind for kind in KINDS.values() if kind.__module__.startswith("splatmorph.flows.")]
    assert len(one) == 2 * (len(ours) - 1 + len(FIELDS)) + 1
    assert one == two
    if hasattr(os, "sched_setaffinity"):
        assert one == fits(OMP_NUM_THREADS="2", ONE_CORE="1")[:-1]
