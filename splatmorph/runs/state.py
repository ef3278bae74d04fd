"""An unfinished fit as it is kept in the run directory, so that it can go on.

state_N.safetensors   the training of leg N: weights, optimizer, generator, and what it is a fit of
"""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from splatmorph.errors import RunError
from splatmorph.fitting import FitState
from splatmorph.io.atomic import atomic_write, make_folder

STATE = "state_{}.safetensors"


def save_state(folder: Path, number: int, state: FitState, asked: str) -> None:
    """Keep an unfinished leg; ``asked`` says what it is a fit of, so that a resumed one can tell.

    Raises:
        WriteError: it can't be written.
    """
    with atomic_write(make_folder(folder) / STATE.format(number)) as partial:
        tensors = {name: tensor.contiguous() for name, tensor in state.tensors.items()}
        partial.write_bytes(save(tensors, metadata={**state.meta, "asked": asked}))


def has_state(folder: Path) -> bool:
    """Whether an unfinished fit was left in ``folder``."""
    return any(folder.glob(STATE.format("*")))


def load_state(folder: Path, number: int, asked: str) -> FitState | None:
    """The unfinished leg ``number`` in ``folder``; None where there is none.

    Raises:
        RunError: it is damaged, or was of other inputs or options.
    """
    path = folder / STATE.format(number)
    if not path.is_file():
        return None
    try:
        with safe_open(path, framework="pt") as stored:
            meta = dict(stored.metadata() or {})
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise RunError(
            f"{path} can't be resumed from ({error}): fit again with `overwrite`"
        ) from error
    if meta.pop("asked", None) != asked:
        raise RunError(
            f"{path} was left by a fit of other inputs or options: give the same ones to "
            "`resume`, or fit anew with `overwrite`"
        )
    return FitState(tensors, meta, str(path))


def drop_states(folder: Path) -> None:
    """Remove what a finished fit needs no longer."""
    for leftover in folder.glob(STATE.format("*")):
        leftover.unlink()
