"""The floors hold: imports point down, third parties stay where they belong."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import pytest

FLOOR = {
    "core": 0,
    "materials": 1,
    "geometry": 1,
    "contact": 1,
    "fem": 2,
    "dynamics": 3,
    "app": 4,
    "cases": 5,
}

# Third party: the floors (or single modules) that may import it.
ALLOWED = {
    "gmsh": {"geometry"},
    "meshio": {"geometry", "app"},
    "skfem": {"fem", "geometry.tagged"},
    "pint": {"core.units", "app"},
    "pydantic": {"app"},
    "pydantic_core": {"core.units", "app"},
    "typer": {"app"},
    "rich": {"app"},
    "h5py": {"app"},
    "psutil": {"app"},
    "tomli_w": {"app", "materials"},
    "pyvista": {"app"},
    "vtkmodules": {"app"},
    "matplotlib": {"app"},
    "PIL": {"app"},
    "pypardiso": {"fem"},
    "numba": {"core", "materials", "contact", "fem", "dynamics"},
    "llvmlite": {"core", "materials", "contact", "fem"},
    "scipy": {"materials", "geometry", "contact", "fem", "dynamics"},
    "numpy": set(FLOOR),
}
# Slow or heavy to load: only inside the function that needs them.
INSIDE_FUNCTIONS = {"gmsh", "meshio", "pyvista", "vtkmodules", "matplotlib", "pint", "h5py"}


def _modules() -> Iterator[tuple[str, str, ast.Module]]:
    for floor in FLOOR:
        root = Path(str(files(f"flexapod.{floor}")))
        for path in sorted(root.rglob("*.py")):
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            yield floor, f"{floor}.{name}", ast.parse(path.read_text(encoding="utf-8"))


MODULES = list(_modules())


def _imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import at line {node.lineno}: write flexapod.x.y"
            module = node.module or ""
            if module == "flexapod":
                yield from (f"flexapod.{alias.name}" for alias in node.names)
            else:
                yield module


def _top_level_imports(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield from _imports(node)


def test_every_floor_has_modules() -> None:
    assert {floor for floor, _, _ in MODULES} == set(FLOOR)


@pytest.mark.parametrize(("floor", "name", "tree"), MODULES, ids=[m[1] for m in MODULES])
def test_imports_point_down(floor: str, name: str, tree: ast.Module) -> None:
    for imported in _imports(tree):
        parts = imported.split(".")
        # "from materials import ..." from the repository root would make a second copy of
        # every class.
        assert parts[0] not in FLOOR, f"{name} imports {imported}: write flexapod.{imported}"
        if parts[0] != "flexapod":
            continue
        assert len(parts) > 1, f"{name} imports the bare namespace"
        other = parts[1]
        assert other == floor or FLOOR[other] < FLOOR[floor], (
            f"{name} (floor {FLOOR[floor]}) imports {imported} (floor {FLOOR[other]})"
        )


@pytest.mark.parametrize(("floor", "name", "tree"), MODULES, ids=[m[1] for m in MODULES])
def test_third_parties_stay_on_their_floor(floor: str, name: str, tree: ast.Module) -> None:
    for imported in _imports(tree):
        top = imported.split(".")[0]
        if top == "flexapod" or top in sys.stdlib_module_names:
            continue
        assert top in ALLOWED, f"{name} imports {top}, which no floor may"
        assert floor in ALLOWED[top] or name in ALLOWED[top], f"{name} must not import {top}"


@pytest.mark.parametrize(("floor", "name", "tree"), MODULES, ids=[m[1] for m in MODULES])
def test_heavy_imports_are_inside_functions(floor: str, name: str, tree: ast.Module) -> None:
    heavy = {imported.split(".")[0] for imported in _top_level_imports(tree)} & INSIDE_FUNCTIONS
    assert not heavy, f"{name} imports {heavy} when it is loaded"


def test_the_bench_extra_holds_what_benchmarks_tell_to_install() -> None:
    root = Path(__file__).parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extra = {re.split(r"[^\w-]", entry)[0] for entry in project["optional-dependencies"]["bench"]}
    asked = {
        word
        for path in (root / "benchmarks").glob("*.py")
        for words in re.findall(r"pip install ([\w -]+)", path.read_text(encoding="utf-8"))
        for word in words.split()
    }
    assert asked
    assert asked <= extra


def _loaded_after(code: str) -> set[str]:
    script = f"{code}\nimport sys\nprint(*sorted({{m.split('.')[0] for m in sys.modules}}))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_the_solver_loads_neither_mesher_nor_pictures() -> None:
    names = [f"flexapod.{name}" for floor, name, _ in MODULES if floor == "fem"]
    code = "\n".join(f"import {name.removesuffix('.__init__')}" for name in names)
    loaded = _loaded_after(code)
    assert "skfem" in loaded
    assert not loaded & {"gmsh", "pyvista", "vtkmodules", "matplotlib", "pint"}


def test_the_command_line_starts_light() -> None:
    loaded = _loaded_after("import flexapod.app.cli")
    heavy = {"gmsh", "pyvista", "matplotlib", "numba", "skfem", "pint", "pydantic", "meshio"}
    assert not loaded & heavy
