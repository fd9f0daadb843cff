"""Probes: single numbers of a state that become columns of curve.csv.

A probe is made once from the reference mesh; `sample` is a pure function of the state and of its
own previous value (a rotation counts turns from it).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import surface_faces
from flexapod.core.errors import InputError

if TYPE_CHECKING:
    from flexapod.app.case import LoadedCase
    from flexapod.geometry.tagged import TaggedMesh


@dataclass(frozen=True)
class Probe:
    """A named column.

    Attributes
    ----------
    head
        Column head with its unit, for example ``angle_deg``.
    sample
        ``sample(x, reactions, previous)``: positions [m] and forces of the supports on the body
        [N], both (node_count, 3), and the probe's last value; returns the value in the unit of
        the head.
    """

    head: str
    sample: Callable[[np.ndarray, np.ndarray, float], float]


def best_rotation(reference: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Rotation matrix that carries reference points onto current ones best, shape (3, 3).

    Least squares after taking out the centroids (W. Kabsch 1976, doi:10.1107/S0567739476001873);
    points in one plane are enough.
    """
    a = reference - reference.mean(axis=0)
    b = current - current.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    proper = np.sign(np.linalg.det(left) * np.linalg.det(right))
    return np.asarray(right.T @ np.diag([1.0, 1.0, proper]) @ left.T)


def angle_about(rotation: np.ndarray, axis: str) -> float:
    """Angle of a rotation about a coordinate axis [deg], in (-180, 180].

    The rotation about the axis that comes nearest to `rotation` in the least-squares sense.
    """
    sign = -1.0 if axis.startswith("-") else 1.0
    i = "xyz".index(axis[-1])
    j, k = (i + 1) % 3, (i + 2) % 3
    sine, cosine = rotation[k, j] - rotation[j, k], rotation[j, j] + rotation[k, k]
    return sign * math.degrees(math.atan2(sine, cosine))


def unwrap(angle: float, previous: float) -> float:
    """The angle plus the whole turns that bring it nearest to the previous one [deg]."""
    return angle + 360.0 * round((previous - angle) / 360.0)


def make_probes(loaded: LoadedCase, mesh: TaggedMesh) -> list[Probe]:
    """Make the probes of a case, in its order."""
    from flexapod.fem.loads import Cavity

    probes = []
    for spec in loaded.case.probe:
        where = f"{loaded.source}: probe.{spec.name}"
        if spec.type == "rotation":
            nodes = np.unique(surface_faces(mesh, spec.surface, f"{where}.surface"))
            if len(nodes) < 3:
                raise InputError("a rotation needs at least three nodes", where)
            probes.append(
                Probe(
                    f"{spec.name}_deg", _rotation(mesh.nodes[nodes], nodes, spec.axis, spec.times)
                )
            )
        elif spec.type == "track":
            nodes = _marked(mesh, spec, where)
            for axis, letter in enumerate("xyz"):
                probes.append(Probe(f"{spec.name}_{letter}_mm", _position(nodes, axis)))
        elif spec.type == "displacement":
            nodes = _marked(mesh, spec, where)
            probes.append(
                Probe(f"{spec.name}_mm", _displacement(mesh.nodes, nodes, spec.direction))
            )
        elif spec.type == "reaction":
            nodes = np.unique(surface_faces(mesh, spec.surface, f"{where}.surface"))
            probes.append(Probe(f"{spec.name}_N", _reaction(nodes, "xyz".index(spec.direction))))
        else:
            faces = surface_faces(mesh, spec.surface, f"{where}.surface")
            probes.append(Probe(f"{spec.name}_ml", _volume(Cavity(spec.name, faces))))
    _check_heads(loaded.source, probes)
    return probes


def _marked(mesh: TaggedMesh, spec: Any, where: str) -> np.ndarray:
    """Nodes of a probe's surface, or the one nearest its point."""
    if spec.surface is not None:
        return np.unique(surface_faces(mesh, spec.surface, f"{where}.surface"))
    away = np.linalg.norm(mesh.nodes - np.asarray(spec.point), axis=1)
    return np.array([int(np.argmin(away))])


def _position(nodes: np.ndarray, axis: int) -> Callable[[np.ndarray, np.ndarray, float], float]:
    def sample(x: np.ndarray, reactions: np.ndarray, previous: float) -> float:
        return 1000.0 * float(x[nodes, axis].mean())

    return sample


def _check_heads(source: str, probes: Sequence[Probe]) -> None:
    heads = [probe.head for probe in probes]
    for head in heads:
        if heads.count(head) > 1:
            raise InputError(f'two probes make the column "{head}"', f"{source}: probe")


def _rotation(
    reference: np.ndarray, nodes: np.ndarray, axis: str, times: float
) -> Callable[[np.ndarray, np.ndarray, float], float]:
    def sample(x: np.ndarray, reactions: np.ndarray, previous: float) -> float:
        angle = angle_about(best_rotation(reference, x[nodes]), axis)
        return times * unwrap(angle, previous / times)

    return sample


def _displacement(
    reference: np.ndarray, nodes: np.ndarray, direction: str
) -> Callable[[np.ndarray, np.ndarray, float], float]:
    start = reference[nodes]

    def sample(x: np.ndarray, reactions: np.ndarray, previous: float) -> float:
        mean = 1000.0 * (x[nodes] - start).mean(axis=0)
        return float(
            np.linalg.norm(mean) if direction == "magnitude" else mean["xyz".index(direction)]
        )

    return sample


def _reaction(nodes: np.ndarray, axis: int) -> Callable[[np.ndarray, np.ndarray, float], float]:
    def sample(x: np.ndarray, reactions: np.ndarray, previous: float) -> float:
        return float(reactions[nodes, axis].sum())

    return sample


def _volume(cavity: object) -> Callable[[np.ndarray, np.ndarray, float], float]:
    def sample(x: np.ndarray, reactions: np.ndarray, previous: float) -> float:
        return 1e6 * float(cavity.volume(x))  # type: ignore[attr-defined]

    return sample
