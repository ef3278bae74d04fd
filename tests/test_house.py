"""The house: which room may look into which, and who knows the terminal."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import renderer.errors
from renderer import orbit
from splatmorph import rendering
from splatmorph.app import COMMANDS, app
from splatmorph.errors import SplatmorphError

HOUSE = Path(__file__).parents[1]
ROOMS = (
    ("_later", "_version", "ahead", "errors", "steady"),
    ("geometry", "renderer", "timeline"),
    ("gaussians",),
    ("io", "rendering", "flows"),
    ("landmark_files", "metrics"),
    ("landmarks",),
    ("fitting", "samples"),
    ("registration",),
    ("images",),
    ("morph",),
    ("avatars",),
    ("runs",),
    ("view",),
    ("app",),
)
"""From the ground up: a room looks into those below it, never up and never beside."""
FLOORS = {room: floor for floor, rooms in enumerate(ROOMS) for room in rooms}
ENTRANCES = ("splatmorph", "__main__")
"""What a user calls: they may look anywhere."""
LIBRARY = [
    path
    for top in ("splatmorph", "renderer")
    for path in sorted((HOUSE / top).rglob("*.py"))
    if "app" not in path.relative_to(HOUSE).parts
]


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(HOUSE).with_suffix("").parts).removesuffix(".__init__")


MODULES = {
    module_of(path): ast.parse(path.read_text(encoding="utf-8"))
    for top in ("splatmorph", "renderer")
    for path in (HOUSE / top).rglob("*.py")
}


def room_of(module: str) -> str:
    parts = module.split(".")
    return parts[0] if parts[0] == "renderer" or len(parts) == 1 else parts[1]


def imported(tree: ast.AST) -> Iterator[str]:
    """Every module that is imported when the code runs, wherever the statement stands."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        if isinstance(child, ast.Import):
            yield from (name.name for name in child.names)
        elif isinstance(child, ast.ImportFrom):
            assert not child.level, "imports are absolute"
            yield from (f"{child.module}.{name.name}" for name in child.names)
        else:
            yield from imported(child)


def arrows(module: str) -> set[str]:
    """The modules of ours that one imports."""
    found = set()
    for name in imported(MODULES[module]):
        while name and name not in MODULES:
            name = name.rpartition(".")[0]
        found |= {name} - {module, ""}
    return found


def test_no_module_imports_itself_by_a_detour() -> None:
    TopologicalSorter({module: arrows(module) for module in MODULES}).prepare()


def test_every_room_looks_down() -> None:
    for module in MODULES:
        here = room_of(module)
        if here in ENTRANCES:
            continue
        for other in map(room_of, arrows(module)):
            below = other == here or other in ENTRANCES or FLOORS[other] < FLOORS[here]
            assert below, f"{module} looks up into {other}"


def test_what_must_not_know_each_other_does_not() -> None:
    def reached(room: str) -> set[str]:
        return {room_of(m) for module in MODULES if room_of(module) == room for m in arrows(module)}

    assert reached("renderer") == {"renderer"}
    assert "gaussians" not in reached("flows")
    everyone = set().union(*(reached(room) for room in FLOORS if room != "app"))
    assert "app" not in everyone


@pytest.mark.parametrize("path", LIBRARY, ids=module_of)
def test_only_the_app_knows_the_terminal(path: Path) -> None:
    names = {name.partition(".")[0] for name in imported(MODULES[module_of(path)])}
    assert not names & {"argparse", "click", "cyclopts", "rich", "readline"}
    if path.name != "__main__.py":
        called = {ast.unparse(n.func) for n in ast.walk(tree_of(path)) if isinstance(n, ast.Call)}
        assert not called & {"print", "input", "sys.exit", "exit"}


def tree_of(path: Path) -> ast.Module:
    return MODULES[module_of(path)]


def said(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Every text that is no docstring, by its line."""
    holders = (ast.Module, ast.ClassDef, ast.FunctionDef)
    statements = [s for node in ast.walk(tree) if isinstance(node, holders) for s in node.body]
    docs = {id(statement.value) for statement in statements if isinstance(statement, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.lineno, node.value


def options() -> set[str]:
    """Every way that an option of ours is spelled."""
    spelled = {"-q", "--quiet", "--verbose"}
    for name in COMMANDS:
        for argument in app[name].assemble_argument_collection():
            spelled |= {each for each in argument.names if each.startswith("-")}
    return spelled


def test_the_library_names_no_option_and_no_command() -> None:
    ours = options()
    assert {"-o", "-w", "--resume", "--landmarks-set", "--no-prune"} <= ours
    command = re.compile(rf"splatmorph +({'|'.join(COMMANDS)})\b")
    for path in LIBRARY:
        for line, text in said(tree_of(path)):
            words = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", text))
            axes = {"-x", "-y", "-z"}
            assert not (words & ours) - axes, f"{module_of(path)}:{line} says {words & ours - axes}"
            assert not command.search(text), f"{module_of(path)}:{line} names a command: {text}"


def test_what_the_library_names_in_backticks_is_an_option() -> None:
    spelled = {option.lstrip("-").replace("-", "_") for option in options()}
    for path in LIBRARY:
        for line, text in said(tree_of(path)):
            for name in re.findall(r"`([a-z_]+)`", text):
                assert name in spelled, f"{module_of(path)}:{line}: no option is called {name}"


def test_what_the_renderer_raises_is_ours_where_we_called_it() -> None:
    raised = {
        error
        for error in vars(renderer.errors).values()
        if isinstance(error, type) and issubclass(error, renderer.errors.RenderError)
    } - {renderer.errors.RenderError}
    assert set(rendering.ERRORS) == raised
    with pytest.raises(SplatmorphError, match="up"):
        rendering.orbit(rendering.bounds_of([[0, 0, 0]], [1], [[1, 1, 1]]), [0.0], up="w")
    assert rendering.orbit.__doc__ == orbit.__doc__


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("import splatmorph", ("pyvista", "vtk", "warp", "viser", "cv2", "matplotlib", "torch")),
        ("import splatmorph.io", ("pxr", "warp", "pyvista")),
        ("import splatmorph.flows", ("warp", "pyvista", "splatmorph.gaussians")),
    ],
)
def test_what_is_heavy_waits(statement: str, heavy: tuple[str, ...]) -> None:
    code = f"import sys\n{statement}\nassert not set(sys.modules) & set({heavy})"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
