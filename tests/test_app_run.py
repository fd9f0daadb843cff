"""What a run says by itself: the warning about a law that leaves its stable range."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from statics_helpers import grid

from flexapod.app import plots
from flexapod.app.case import LoadedCase, load_case
from flexapod.app.outputs import SUMMARY_FILE
from flexapod.app.run import run_case
from flexapod.core.errors import Status
from flexapod.geometry.meshfile import write_mesh
from flexapod.materials.mooney_rivlin import MooneyRivlin
from flexapod.materials.stability import stable_range

# Two cells on top of each other, pulled alike along x and y to a stretch of 1.8 and free along
# z: equibiaxial tension of both. The upper one's law softens, the lower one's never does.
CASE = """
mesh = { file = "stack.vtu" }

material = [
    { group = "upper", model = "mooney-rivlin", c = ["100 kPa", "-20 kPa"], density = "1 g/cm^3" },
    { group = "*", model = "neo-hooke", mu = "160 kPa", density = "1 g/cm^3" },
]
support = [
    { surface = "x0", directions = ["x"] },
    { surface = "y0", directions = ["y"] },
    { surface = "z0", directions = ["z"] },
]
displacement = [
    { name = "pull", surface = "x1", x = "800 mm" },
    { name = "also", surface = "y1", y = "800 mm" },
]
pressure = [{ name = "air", surface = "z1", value = "80 Pa" }]
step = [{ name = "load", loads = { pull = 1.0, also = 1.0, air = 1.0 }, outputs = 8 }]
probe = [{ type = "displacement", name = "top", surface = "z1", direction = "z" }]
"""


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(plots, "draw_all", lambda folder: ([], []))
    write_mesh(grid((1, 1, 2)).with_cell_group("upper", [1]), tmp_path / "stack.vtu")
    file = tmp_path / "stack.toml"
    file.write_text(CASE)
    return file


def _said(loaded: LoadedCase, out: Path) -> tuple[list[str], list[str]]:
    """Notices of a run about stability: as they were said, and as they were kept."""
    said: list[str] = []
    result = run_case(loaded, out, say=said.append)
    assert result.status is Status.DONE, result.message
    kept = json.loads((out / SUMMARY_FILE).read_text())["warnings"]
    return [s for s in said if "stable" in s], [s for s in kept if "stable" in s]


def test_a_law_that_leaves_its_stable_range_is_named_once(case: Path, tmp_path: Path) -> None:
    limit = stable_range(MooneyRivlin(1e5, -2e4), "equibiaxial").high
    # The stretch grows by 0.1 per output and the pressure by 10 Pa: the limit lies between the
    # sixth and the seventh, and the eighth is beyond it too but adds nothing.
    assert 1.6 < limit < 1.7
    expected = (
        "at 0.07 kPa, 1 elements (first 1) left the stable range of 'mooney-rivlin': "
        "the law softens there"
    )
    said, kept = _said(load_case(str(case)), tmp_path / "far")
    assert said == kept == [expected]


def test_within_the_stable_range_nothing_is_said(case: Path, tmp_path: Path) -> None:
    settings = ["displacement.pull.x=600 mm", "displacement.also.y=600 mm"]
    said, kept = _said(load_case(str(case), settings), tmp_path / "near")
    assert said == kept == []
