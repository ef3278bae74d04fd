"""What starts at once: asking for help loads nothing that computes."""

from __future__ import annotations

import subprocess
import sys
from typing import get_args, get_type_hints

import pytest

from splatmorph.app import COMMANDS, run
from splatmorph.app.export import frame_formats

HEAVY = ("torch", "scipy", "warp", "plyfile", "PIL", "trimesh", "pyvista", "viser", "cv2")
ASKED = [["--version"], ["--help"], *([name, "--help"] for name in sorted(COMMANDS))]


def test_no_help_loads_what_computes() -> None:
    code = (
        "import sys\nfrom splatmorph.app import run\n"
        f"for words in {ASKED}:\n"
        "    assert run(words) == 0, words\n"
        f"    assert not set(sys.modules) & set({HEAVY}), words\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize("package", ["splatmorph", "splatmorph.runs"])
def test_names_that_wait_are_there(package: str) -> None:
    module = __import__(package, fromlist=["__all__"])
    assert all(hasattr(module, name) for name in module.__all__)
    assert set(module.__all__) <= set(dir(module))
    with pytest.raises(AttributeError, match="nothing_such"):
        _ = module.nothing_such


def test_the_help_of_an_export_names_every_format(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", "--help"]) == 0
    said = capsys.readouterr().out
    assert all(kind in said for kind in frame_formats())


def test_defaults_that_are_written_twice_agree() -> None:
    from splatmorph.app.options import Blend, Blending, Covariance, Ramp, Searching
    from splatmorph.fitting import FitConfig
    from splatmorph.flows import Node
    from splatmorph.flows.node import FIELDS
    from splatmorph.images.picture import MOST_PIXELS
    from splatmorph.morph.morph import BLENDS
    from splatmorph.morph.ramps import EASES, RAMPS
    from splatmorph.morph.transport import COVARIANCES
    from splatmorph.registration.search import COUNT
    from splatmorph.runs import Finding, Fitting

    assert Finding().count == Searching().count == COUNT
    assert (Fitting().flow, Fitting().smoothing) == (Node.kind, FitConfig.smoothing)
    for words, known in ((Blend, BLENDS), (Ramp, RAMPS), (Covariance, COVARIANCES)):
        assert set(get_args(words)) == set(known)
    for name, of, known in (("ease", Blending, EASES), ("field", Fitting, FIELDS)):
        assert set(get_args(get_args(get_type_hints(of)[name])[0])) == set(known)
    app = __import__("splatmorph.app.image", fromlist=["image"])
    assert app.image.__kwdefaults__["max_pixels"] == MOST_PIXELS
