"""Write cases/own_mesh.vtu: a hollow finger on a stiff plate, and a block to push it with.

Run from the repository root with the package installed: ``python scripts/make_own_mesh.py``.
The mesh stands for one that a user brings; any mesher that writes eight-node hexahedra and
groups would do.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flexapod.geometry.meshfile import write_mesh
from flexapod.geometry.tagged import HEX_FACES, TaggedMesh


def bricks(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [m] and hexahedra of a lattice."""
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape(len(x), len(y), len(z))
    corners = [
        number[i : len(x) - 1 + i, j : len(y) - 1 + j, k : len(z) - 1 + k].ravel()
        for i, j, k in np.array(
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
        )
    ]
    return nodes, np.stack(corners, axis=1)


def main() -> None:
    """Build both bodies, name their groups, write the file."""
    finger_nodes, finger = bricks(
        np.linspace(0.0, 60e-3, 16), np.linspace(0.0, 16e-3, 5), np.linspace(0.0, 16e-3, 5)
    )
    middle = finger_nodes[finger].mean(axis=1)
    low, high = np.array([4e-3, 4e-3, 8e-3]), np.array([56e-3, 12e-3, 12e-3])
    hollow = np.all((middle > low) & (middle < high), axis=1)
    finger = finger[~hollow]
    block_nodes, block = bricks(
        np.linspace(44e-3, 60e-3, 4), np.linspace(0.0, 16e-3, 4), np.linspace(-14e-3, -6e-3, 3)
    )
    cells = np.concatenate([finger, block + len(finger_nodes)])
    nodes = np.concatenate([finger_nodes, block_nodes])
    used, cells = np.unique(cells, return_inverse=True)
    nodes, cells = nodes[used], cells.reshape(-1, 8)
    is_block = np.arange(len(cells)) >= len(finger)
    middle = nodes[cells].mean(axis=1)

    faces = cells[:, HEX_FACES].reshape(-1, 4)
    owner = np.repeat(np.arange(len(cells)), 6)
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    skin = np.sort(first[count == 1])
    faces, owner = faces[skin], owner[skin]
    centre = nodes[faces].mean(axis=1)
    inside = np.all((centre > low - 1e-6) & (centre < high + 1e-6), axis=1) & ~is_block[owner]

    def at(axis: int, value: float, block: bool) -> np.ndarray:
        chosen = np.isclose(centre[:, axis], value) & (is_block[owner] == block) & ~inside
        return faces[chosen]

    mesh = TaggedMesh(
        nodes,
        cells,
        {
            "silicone": np.flatnonzero(~is_block & (middle[:, 2] > 4e-3)),
            "plate": np.flatnonzero(~is_block & (middle[:, 2] < 4e-3)),
            "block": np.flatnonzero(is_block),
        },
        {
            "root": at(0, 0.0, False),
            "tip": at(0, 60e-3, False),
            "underside": at(2, 0.0, False),
            "top": at(2, 16e-3, False),
            "cavity": faces[inside],
            "block_top": at(2, -6e-3, True),
            "block_foot": at(2, -14e-3, True),
        },
        ("cavity",),
    )
    path = write_mesh(mesh, Path("cases") / "own_mesh.vtu")
    print(f"{path}: {len(mesh.cells)} hexahedra, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
