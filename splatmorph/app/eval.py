"""``splatmorph eval``: Measure a run: landmark errors, flow laws, folding, energies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Json, Out, Overwrite, RunPath

WORST_SHOWN = 5


def eval(
    run: RunPath,
    /,
    *,
    held_out: Annotated[
        Path | None,
        Parameter(
            help="True correspondences to score on: .npz with arrays source and target (m, 3), "
            "or .csv of six columns x, y, z, x, y, z."
        ),
    ] = None,
    out: Out = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure a run: landmark errors, flow laws, folding, energies.

    -o keeps what --json prints in a file.
    """
    from splatmorph.io.atomic import write_json
    from splatmorph.runs import open_run
    from splatmorph.runs.measuring import measure, read_pairs

    if out is not None:
        console.claim(out, overwrite)
    pairs = None if held_out is None else read_pairs(held_out)
    legs = measure(open_run(run), pairs)
    if out is not None:
        write_json(out, {"run": str(run), "legs": legs})
    if json:
        console.emit_json({"run": str(run), "legs": legs})
    else:
        for leg in legs:
            _print(leg)
        if out is not None:
            console.say(f"wrote {out}")


def _print(measured: dict[str, Any]) -> None:
    laws, options = measured["laws"], measured["flow"]
    name = " ".join(str(options[key]) for key in ("kind", "field") if key in options)
    console.say(f"{name}: {measured['landmarks']} landmarks, {measured['splats']:,} splats")
    made = console.table("", "before", "after")
    made.add_row(
        "landmark MSE, world units²",
        f"{measured['mse_world_before']:.2e}",
        f"{measured['mse_world']:.2e}",
    )
    made.add_row(
        "  in units of the box²", f"{measured['mse_before']:.2e}", f"{measured['mse']:.2e}"
    )
    if held := measured.get("held_out"):
        made.add_row(
            f"held out, mean of {held['points']:,}, world units",
            f"{held['mean_before']:.4g}",
            f"{held['mean']:.4g}",
        )
    if gap := measured.get("surfaces"):
        made.add_row("surfaces at half-time, mean distance, world units", "", f"{gap['mean']:.3g}")
        made.add_row("  share without a counterpart", "", f"{gap['alone']:.1%}")
    for landmark, error in list(measured["errors"].items())[:WORST_SHOWN]:
        made.add_row(f"landmark {landmark}, at its worst t", "", f"{error:.3g}")
    for law in ("identity", "inverse", "group"):
        made.add_row(f"{law} error, of the box", "", f"{laws[law]:.1e}")
    where = ", ".join(f"{value:.4g}" for value in measured["det_min_at"])
    made.add_row(f"least determinant, at ({where})", "", f"{measured['det_min']:.3f}")
    made.add_row("largest determinant", "", f"{measured['det_max']:.3f}")
    made.add_row("first-order energy", "", f"{measured['energy_first']:.4f}")
    made.add_row("second-order energy", "", f"{measured['energy_second']:.3f}")
    console.say(made)
