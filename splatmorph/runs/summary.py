"""What a batch ends with: its results as a table for machines, and as a page to look at."""

from __future__ import annotations

import csv
import dataclasses
import html
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

import imageio_ffmpeg
from PIL import Image

from splatmorph.io.atomic import atomic_write, make_folder
from splatmorph.runs.batch import Result

THUMBNAILS = "thumbnails"
SIDE = 128

PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width">
<style>
:root {{ color-scheme: light dark; font: 15px/1.4 system-ui, sans-serif }}
body {{ margin: 2rem }}
table {{ border-collapse: collapse }}
th, td {{ padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #8884 }}
th {{ position: sticky; top: 0; background: Canvas }}
th button {{ all: unset; cursor: pointer }}
th button:focus-visible {{ outline: 2px solid }}
th[aria-sort=ascending] button::after {{ content: " ▲" }}
th[aria-sort=descending] button::after {{ content: " ▼" }}
.text {{ text-align: left }}
td[data-value] {{ white-space: nowrap }}
.failed {{ color: #c33 }} .missed {{ color: #b70 }}
img {{ display: block; max-width: 128px; max-height: 128px }}
</style>
<h1>{title}</h1>
<p>{counts}</p>
<table><thead><tr>{head}</tr></thead>
<tbody>
{rows}
</tbody></table>
<script>
const body = document.querySelector("tbody");
document.querySelectorAll("th button").forEach(button => button.onclick = () => {{
  const head = button.parentElement, column = head.cellIndex;
  const down = head.getAttribute("aria-sort") === "ascending";
  document.querySelectorAll("th").forEach(one => one.removeAttribute("aria-sort"));
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const key = row => row.cells[column].dataset.value ?? row.cells[column].textContent;
  const compare = (a, b) => {{
    if (!a || !b) return !a - !b;  // what has no value comes last, whichever way
    const order = isNaN(a) || isNaN(b) ? a.localeCompare(b) : a - b;
    return down ? -order : order;
  }};
  body.append(...[...body.rows].sort((a, b) => compare(key(a), key(b))));
}});
</script>
</html>
"""


def write_summary(path: Path, results: Sequence[Result]) -> None:
    """A CSV file with a line a result.

    Raises ``WriteError``.
    """
    columns = [field.name for field in dataclasses.fields(Result)]
    with atomic_write(path) as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        for result in results:
            cells = dataclasses.asdict(result) | {"files": "; ".join(result.files)}
            writer.writerow(cells.values())


def write_page(path: Path, results: Sequence[Result], title: str) -> None:
    """An HTML page with a row a result, sorted by any column; it needs nothing but its folder.

    Raises ``WriteError``.
    """
    columns = [field for field in dataclasses.fields(Result) if field.name != "files"]
    head = "".join(
        f'<th class="{"text" if "str" in str(field.type) else "number"}"><button>'
        f"{field.name.replace('_', ' ')}</button></th>"
        for field in columns
    )
    statuses = [result.status for result in results]
    counts = ", ".join(f"{statuses.count(one)} {one}" for one in sorted(set(statuses)))
    rows = "\n".join(_row(path.parent, result) for result in results)
    page = PAGE.format(
        title=html.escape(title),
        counts=f"{len(results)} rows: {counts}",
        head=f'<th></th>{head}<th class="text">files</th>',
        rows=rows,
    )
    with atomic_write(path) as partial:
        partial.write_text(page, encoding="utf-8")


def _row(folder: Path, result: Result) -> str:
    return f'<tr class="{result.status}">{"".join(_cells(folder, result))}</tr>'


def _cells(folder: Path, result: Result) -> Iterator[str]:
    picture = thumbnail_of(folder, result.name)
    shown = ""
    if picture.is_file() and result.status != "failed":
        shown = f'<img loading="lazy" alt="" src="{quote(f"{THUMBNAILS}/{picture.name}")}">'
    yield f"<td>{shown}</td>"
    for name, value in vars(result).items():
        if name == "files":
            links = (f'<a href="{quote(file)}">{html.escape(file)}</a>' for file in result.files)
            yield f'<td class="text">{" ".join(links)}</td>'
        elif isinstance(value, int | float):
            yield f'<td data-value="{value!r}">{value:.3g}</td>'
        else:
            text = "" if value is None else html.escape(str(value))
            yield f'<td class="text">{text}</td>'


def thumbnail_of(folder: Path, name: str) -> Path:
    """Where the small picture of a row is."""
    return folder / THUMBNAILS / f"{name}.jpg"


def draw_thumbnail(folder: Path, name: str, picture: Path) -> None:
    """Draw the small picture of a row: the middle of the morph that ``picture`` is, once.

    ``picture`` is a still, a video that goes there and back, or a folder of such frames.

    Raises ``WriteError``.
    """
    path = thumbnail_of(folder, name)
    if path.is_file() and path.stat().st_mtime >= picture.stat().st_mtime:
        return
    make_folder(path.parent)
    small = _middle_of(picture)
    small.thumbnail((SIDE, SIDE))
    with atomic_write(path) as partial:
        small.save(partial, quality=85)


def _middle_of(picture: Path) -> Image.Image:
    if picture.is_dir():
        stills = sorted(picture.iterdir())
        picture = stills[len(stills) // 4]
    if picture.suffix.lower() == ".mp4":
        frames, _ = imageio_ffmpeg.count_frames_and_secs(str(picture))
        reader = imageio_ffmpeg.read_frames(str(picture))
        size = next(reader)["size"]
        frame = next(itertools.islice(reader, frames // 4, None))
        reader.close()
        return Image.frombytes("RGB", size, frame)
    with Image.open(picture) as opened:
        opened.seek(getattr(opened, "n_frames", 1) // 4)
        over = Image.new("RGBA", opened.size, "white")
        over.alpha_composite(opened.convert("RGBA"))
    return over.convert("RGB")
