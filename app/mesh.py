"""The mesh of a case, written with its groups and judged."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexapod.app.assemble import build_mesh, make_builder, make_material, mesh_hash
from flexapod.app.case import LoadedCase
from flexapod.app.run import stdout_to_stderr
from flexapod.core.errors import InputError


@dataclass(frozen=True)
class MeshReport:
    """What `flexapod mesh` answers: as a table for JSON and as text."""

    table: dict[str, Any]
    text: str


def write_case_mesh(
    loaded: LoadedCase, out: Path, plot: Path | None, say: Callable[[str], None]
) -> MeshReport:
    """Build or read the mesh of a case, write it, draw it and report its quality."""
    from flexapod.geometry.meshfile import write_mesh
    from flexapod.geometry.quality import mesh_quality

    for path, wanted in ((out, (".msh", ".vtu")), (plot, (".png",))):
        if path is not None and path.suffix.lower() not in wanted:
            raise InputError(
                f"write a name ending in {' or '.join(wanted)}; got {path}",
                "--out" if path is out else "--plot",
            )
    with stdout_to_stderr():
        mesh = build_mesh(loaded)
        expected = None
        if loaded.case.mesh is not None and loaded.case.mesh.builder is not None:
            expected = make_builder(loaded.case.mesh, loaded.source).expected_volume()
        # The report weighs the body as if it were all of the first material.
        first = loaded.case.material[0]
        density = make_material(loaded, first, f"{loaded.source}: material.0").density
        quality = mesh_quality(mesh, expected, density)
        out.parent.mkdir(parents=True, exist_ok=True)
        write_mesh(mesh, out)
        if plot is not None:
            from flexapod.app.plots import plot_mesh

            notice = plot_mesh(mesh, plot, loaded.name, loaded.case.plot.view)
            if notice:
                say(notice)
    table = {
        "case": loaded.name,
        "file": str(out),
        "plot": None if plot is None else str(plot),
        "mesh_hash": mesh_hash(mesh),
        **dataclasses.asdict(quality),
        "volume_error": quality.volume_error,
        "mass": quality.mass,
        "cell_groups": {name: len(cells) for name, cells in mesh.cell_groups.items()},
        "facet_groups": {name: len(faces) for name, faces in mesh.facet_groups.items()},
        "cavities": list(mesh.cavities),
    }
    groups = "\n".join(
        f"surface {name:24}{len(faces)} faces" for name, faces in mesh.facet_groups.items()
    )
    return MeshReport(table, f"{quality.text()}\n{groups}\nwritten: {out}")
