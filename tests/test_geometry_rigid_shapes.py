"""Surfaces of rigid shapes: closed, outward, and holding the volume and inertia of their shape."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.dynamics.rigid import box, cylinder, sphere
from flexapod.geometry.rigid_shapes import (
    RigidSurface,
    box_surface,
    cylinder_surface,
    sphere_surface,
    wedge_corners,
    wedge_surface,
)

SIZE = (0.02, 0.03, 0.01)
R, L = 0.01, 0.03


def _inside(surface: RigidSurface) -> tuple[float, np.ndarray]:
    """Volume [m3] and inertia about the origin at unit density, by the divergence theorem.

    Tetrahedra from the origin to four triangles per face; exact for flat faces.
    """
    corner = surface.nodes[surface.faces]
    middle = corner.mean(axis=1)
    volume, second = 0.0, np.zeros((3, 3))
    for k in range(4):
        a, b = corner[:, k], corner[:, (k + 1) % 4]
        part = np.einsum("ij,ij->i", a, np.cross(b, middle)) / 6.0
        volume += part.sum()
        for r, factor in ((a + b + middle, 1.0), (a, 1.0), (b, 1.0), (middle, 1.0)):
            second += np.einsum("n,ni,nj->ij", factor * part / 20.0, r, r)
    return float(volume), np.trace(second) * np.eye(3) - second


SHAPES: list[tuple[str, Callable[[float | None], RigidSurface], tuple[float, np.ndarray]]] = [
    ("box", lambda h: box_surface(SIZE, h), box(SIZE, 1.0)),
    ("sphere", lambda h: sphere_surface(R, h), sphere(R, 1.0)),
    *(
        (f"cylinder_{axis}", lambda h, i=i: cylinder_surface(R, L, h, i), cylinder(R, L, 1.0, i))  # type: ignore[misc]
        for i, axis in enumerate("xyz")
    ),
]


@pytest.mark.parametrize(("name", "make", "exact"), SHAPES, ids=[s[0] for s in SHAPES])
def test_a_surface_is_closed_and_holds_its_shape(
    name: str,
    make: Callable[[float | None], RigidSurface],
    exact: tuple[float, np.ndarray],
) -> None:
    errors = []
    for size in (None, 0.5e-3):
        surface = make(size)
        faces = surface.faces
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2), axis=1)
        _, count = np.unique(sides, axis=0, return_counts=True)
        # Closed, and of one piece without holes (Euler: 2).
        assert set(count) == {2}
        assert len(surface.nodes) - len(count) + len(faces) == 2
        p = surface.nodes[faces]
        normal = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])
        assert (np.einsum("ij,ij->i", normal, p.mean(axis=1)) > 0.0).all()
        volume, inertia = _inside(surface)
        errors.append([1.0 - volume / exact[0], np.abs(inertia - exact[1]).max() / exact[1].max()])
        # The extents are the shape's own: round-off.
        half = {"box": 0.5 * np.array(SIZE), "sphere": np.full(3, R)}.get(name)
        if half is None:
            half = np.full(3, R)
            half["xyz".index(name[-1])] = 0.5 * L
        assert np.abs(np.abs(surface.nodes).max(axis=0) - half).max() < 1e-12
    if name == "box":
        assert np.max(errors) < 1e-12  # flat faces: round-off of a sum over a thousand of them
        return
    # A regular polygon of edge h holds 1 - h^2 / 6 R^2 of its circle's area: 0.6 % are missing at
    # the 32 edges a cylinder has by default. A sphere's faces fall short in two directions, and
    # those in the middle of a side are the widest. Measured 0.64 and 0.80 %, 1.7 and 2.9 %.
    assert 0.0 < errors[0][0] < 0.02
    assert errors[0][1] < 0.03
    # Second order: four times finer at least (the counts are even), a sixteenth and a bit.
    assert errors[1][0] < errors[0][0] / 10.0
    assert errors[1][1] < errors[0][1] / 10.0


def test_nodes_of_round_shapes_lie_on_them() -> None:
    ball = sphere_surface(R)
    assert np.abs(np.linalg.norm(ball.nodes, axis=1) - R).max() < 1e-12  # round-off
    drum = cylinder_surface(R, L)
    side = np.abs(drum.nodes[:, 1]) < 0.499 * L
    radius = np.hypot(drum.nodes[:, 0], drum.nodes[:, 2])
    assert np.abs(radius[side] - R).max() < 1e-12


def test_a_mesh_is_the_same_again() -> None:
    one, two = sphere_surface(R), sphere_surface(R)
    assert np.array_equal(one.nodes, two.nodes)
    assert np.array_equal(one.faces, two.faces)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: box_surface((0.01, 0.0, 0.01)), "along y"),
        (lambda: sphere_surface(0.01, -1.0), "mesh_size"),
        (lambda: sphere_surface(1.0, 1e-3), "more than"),
        (lambda: cylinder_surface(0.01, 0.01, axis=3), "axis"),
    ],
)
def test_refusals(make: Callable[[], RigidSurface], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_a_wedge_stands_on_less_than_its_length() -> None:
    """Ends of 60 and 70 degrees: by hand, from the trapezoid's area and centre.

    Heights h: the underside is shorter by h cot 60 + h cot 70, the volume the mean of both
    lengths times h times the width. Flat sides: exact.
    """
    size = (0.045, 0.1, 0.015)
    front, back = math.radians(60.0), math.radians(70.0)
    surface = wedge_surface(size, front, back, 5e-3)
    cut = [0.015 / math.tan(a) for a in (front, back)]
    below = 0.045 - sum(cut)
    volume, _ = _inside(surface)
    assert volume == pytest.approx(0.5 * (0.045 + below) * 0.015 * 0.1, rel=1e-12)
    low = surface.nodes[np.unique(surface.sides["bottom"])]
    assert low[:, 2].max() == pytest.approx(-0.0075)
    assert low[:, 0].min() == pytest.approx(-0.0225 + cut[1])
    assert low[:, 0].max() == pytest.approx(0.0225 - cut[0])
    assert sum(len(f) for f in surface.sides.values()) == len(surface.faces)
    assert set(surface.sides) == {"bottom", "top", "front", "back", "flanks"}
    # Turned by its angle, an end lies flat: its normal is (sin 60, 0, -cos 60).
    corner = surface.nodes[surface.sides["front"]]
    normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    along = [[math.sin(front), 0.0, -math.cos(front)]] * len(normal)
    np.testing.assert_allclose(normal, along, atol=1e-14)
    box_nodes = wedge_corners(size, 0.5 * math.pi, 0.5 * math.pi)
    np.testing.assert_allclose(np.abs(box_nodes), [[0.0225, 0.05, 0.0075]] * 8, atol=1e-15)
    with pytest.raises(InputError, match="no underside left"):
        wedge_corners((0.01, 0.1, 0.03), front, back)
    with pytest.raises(InputError, match=r"front_angle must lie in \[10, 90\] deg, got 95"):
        wedge_corners(size, math.radians(95.0), back)
