"""Gmsh, borrowed for one mesh: its session, and the elements it made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from flexapod.core.errors import InputError

# Gmsh's numbers of linear quadrilaterals and hexahedra, and their corners.
QUADRILATERAL, HEXAHEDRON = 3, 5
_CORNERS = {QUADRILATERAL: 4, HEXAHEDRON: 8}


def import_gmsh() -> Any:
    """Return Gmsh; raises `InputError` with the system libraries it lacks."""
    try:
        import gmsh
    except (ImportError, OSError) as problem:
        raise InputError(
            f"Gmsh cannot be loaded ({problem}); its wheel needs system libraries: on Debian "
            "install libglu1-mesa libxft2 libxcursor1 libxinerama1 libgl1 libxrender1 "
            "libfontconfig1",
            "mesh",
        ) from problem
    return gmsh


@contextmanager
def gmsh_model(name: str) -> Iterator[Any]:
    """Gmsh with a model of its own, which goes at the end; a caller's session is left as it was."""
    gmsh = import_gmsh()
    had_session = bool(gmsh.isInitialized())
    if not had_session:
        # A user's .gmshrc must not change the mesh.
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
    previous = gmsh.model.getCurrent() if had_session else ""
    gmsh.model.add(f"flexapod-{name}")
    try:
        yield gmsh
    finally:
        gmsh.model.remove()
        if not had_session:
            gmsh.finalize()
        elif previous:
            gmsh.model.setCurrent(previous)


def generate(gmsh: Any, kind: int, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Mesh the current model with elements of one kind.

    Returns
    -------
    All node positions [m], shape (n, 3), used or not, and corners, shape (m, 4 or 8), in Gmsh's
    order.
    """
    gmsh.model.geo.synchronize()
    dimension = 2 if kind == QUADRILATERAL else 3
    gmsh.model.mesh.generate(dimension)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    types, _, connectivity = gmsh.model.mesh.getElements(dimension)
    if list(types) != [kind]:
        raise RuntimeError(
            f"Gmsh filled {what} with element types {list(types)}, expected [{kind}]"
        )
    row = np.full(int(tags.max()) + 1, -1)
    row[tags.astype(int)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3), row[connectivity[0].astype(int)].reshape(-1, _CORNERS[kind])


__all__ = ["HEXAHEDRON", "QUADRILATERAL", "generate", "gmsh_model", "import_gmsh"]
