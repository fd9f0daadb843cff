"""Every shipped case loads, names only groups its mesh has, and starts to run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flexapod.app import plots
from flexapod.app.assemble import assemble, build_mesh
from flexapod.app.case import LoadedCase, load_case, shipped_cases
from flexapod.app.probes import make_probes
from flexapod.app.run import run_case
from flexapod.core.errors import Status

COARSE = {
    "curl": ["mesh.size=coarse"],
    "curl_side": ["mesh.size=coarse"],
    "turn": ["mesh.size=coarse"],
    "free_curl": ["mesh.size=coarse", "mesh.units=2"],
}
ROLLING = {"roll_passive", "roll_threshold"}
RINGS = {"ring_crawl", "ring_crawl_sweep", "ring_climb", "ring_jump", "sphere_crawl"}
ROBOTS = {
    "stand", "walk_tripod", "walk_turn", "walk_turn_air", "spot_turn", "climb", "climb_tripod",
    "obstacle_70mm", "rubble", "pronk_earth", "pronk_mars", "pronk_moon", "roll_active",
    "roll_rocking",
}  # fmt: skip
# The last two are looked at in test_app_rigid and test_app_robot.
MOVING = ROLLING | RINGS | ROBOTS | {"payload_drop", "arch"}


@pytest.fixture(autouse=True)
def _matplotlib_only(monkeypatch: pytest.MonkeyPatch) -> None:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")


def _coarse(name: str, *more: str) -> LoadedCase:
    return load_case(name, [*COARSE.get(name, []), *more])


def test_moving_cases_are_known() -> None:
    assert {n for n in shipped_cases() if load_case(n).case.dynamics is not None} == MOVING


def test_what_papers_say_is_said_of_results_that_exist() -> None:
    """By the names of docs/cases.md; and of one case only, not of those that extend it."""
    known = {
        "mean_speed_m_s", "steady_speed_m_s", "airborne_fraction", "jump_height_m", "yaw_deg",
        "steepest_slope_deg", "uphill_m", "cleared", "turns", "distance_m",
        "marker_peak_speed_m_s", "displacement_per_cycle_m",
    }  # fmt: skip
    said = {name: load_case(name).case.paper for name in sorted(ROBOTS | {"arch"})}
    assert set().union(*said.values()) == known
    assert [name for name, words in said.items() if not words] == ["stand"]
    assert list(said["spot_turn"]) == ["yaw_deg"]


@pytest.mark.parametrize("name", sorted(ROLLING))
def test_everything_a_moving_case_names_exists(name: str) -> None:
    from flexapod.app.motion_model import assemble_motion

    loaded = load_case(name)
    motion = assemble_motion(loaded, None, lambda text: None, settle=False)
    make_probes(loaded, motion.mesh)
    # Half of the robot without the parts of it that are neither silicone nor carried.
    carried = 0.5 * sum(m.total for m in loaded.case.mass)
    solid = motion.body.node_mass.sum()
    assert motion.mass == pytest.approx(carried + solid, rel=1e-9)
    assert motion.model.rigid.names == ("servo_1", "servo_2", "servo_2_mirrored")
    assert len(motion.model.bonds) == 1


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_everything_a_robots_case_names_exists(name: str) -> None:
    from flexapod.app.motion_model import assemble_motion
    from flexapod.dynamics.surface_contact import SKIN, SurfaceContact

    loaded = load_case(name)
    motion = assemble_motion(loaded, None, lambda text: None, settle=False)
    make_probes(loaded, motion.mesh)
    half = "y" in loaded.case.plot.mirror
    assert motion.mass == pytest.approx(0.95 if half else 1.9, rel=0.02)  # the paper's 1.9 kg
    assert motion.model.joints.count == (3 if half else 6)
    assert len(motion.model.chambers) == len(loaded.case.pressure)
    # Chambers meet; a box has none.
    faced = [c for c in motion.model.contacts if isinstance(c, SurfaceContact)]
    assert len(faced) == (0 if loaded.case.rigid_bodied else 1)
    (spec,) = [c for c in loaded.case.contact if c.type == "self"]
    assert [c.skin for c in faced] == [spec.skin or SKIN] * len(faced)


@pytest.mark.parametrize("name", sorted(RINGS))
def test_rings_start_to_move(name: str) -> None:
    from flexapod.app.motion_model import assemble_motion
    from flexapod.dynamics.integrator import Options, energies, march

    loaded = load_case(name, ["actuation.held=0 s"])
    motion = assemble_motion(loaded, None, lambda text: None)
    march(motion.model, motion.state, motion.work, 2, Options(5e-3))
    # The ground bears it, and coils pull: D_on t, up to the last step.
    (ground,) = motion.model.contacts
    assert ground.pressing() > 0.0
    assert motion.state.lines["active"].max() == pytest.approx(0.15 * 0.01, rel=0.02)
    ledger = energies(motion.model, motion.state, motion.work)
    assert abs(ledger.kinetic) < 1e-4
    assert ledger.lines > 0.0


def test_a_sweep_and_a_climb_say_what_they_try() -> None:
    from flexapod.app.sweep import combinations

    sweep = load_case("ring_crawl_sweep").case.sweep
    assert sweep is not None
    assert len(combinations(sweep)) == 3 * len(sweep.over[1].values)
    search = load_case("ring_climb").case.search
    assert search is not None
    assert search.goal == "climb"
    assert "BF" in search.patterns


@pytest.mark.parametrize("name", sorted(set(shipped_cases()) - MOVING))
def test_everything_a_case_names_exists(name: str) -> None:
    loaded = _coarse(name)
    mesh = build_mesh(loaded)
    parts = assemble(loaded, mesh)
    make_probes(loaded, mesh)
    assert parts.body.cell_count > 0
    assert [step.name for step in parts.steps] == [step.name for step in loaded.case.steps]
    assert np.all(parts.node_mass > 0.0)


def test_carried_mass_of_the_whole_body() -> None:
    loaded = _coarse("curl", "mesh.symmetry=half", "support.1.surface=side_right")
    parts = assemble(loaded, build_mesh(loaded))
    carried = parts.node_mass.sum() - parts.body.node_mass.sum()
    # Half of what the whole body carries, whatever the mesh.
    assert carried == pytest.approx(0.5 * sum(m.total for m in loaded.case.mass), rel=1e-9)


def test_contact_stiffness_is_the_papers() -> None:
    loaded = _coarse("curl", "material=[{use='dragon-skin-20-sospider'}]")
    contacts = assemble(loaded, build_mesh(loaded)).problem.contacts
    plane, chambers, mirror = (contact.law.stiffness for contact in contacts)  # type: ignore[attr-defined]
    millimetres = 1000.0**1.5  # N/m^1.5 per N/mm^1.5
    assert chambers / millimetres == pytest.approx(97.0, abs=0.5)  # SoSpider, section 3.3
    assert plane / millimetres == pytest.approx(194.0, abs=1.0)  # against metal
    assert mirror == pytest.approx(4.0 * chambers)  # F = k (2 d)**2


def test_free_curl_curls_and_contact_keeps_chambers_apart(tmp_path: Path) -> None:
    loaded = _coarse("free_curl", "pressure.inflation.value=8 kPa", "step.inflate.outputs=4")
    result = run_case(loaded, tmp_path / "r")
    assert result.status is Status.DONE, result.message
    results = result.summary["results"]
    # Baseline of this coarse mesh: 8.7 deg for two units at 8 kPa; positive is upwards.
    assert 6.0 < results["angle_deg"] < 13.0
    assert results["air_ml"] > 0.0
    assert results["least_stretch"] < 1.0 < results["largest_stretch"]


def test_own_mesh_shows_every_kind_of_probe_and_load(tmp_path: Path) -> None:
    loaded = load_case("own_mesh", ["step.inflate.outputs=1", "step.push.outputs=1"])
    result = run_case(loaded, tmp_path / "r")
    assert result.status is Status.DONE, result.message
    case = loaded.case
    assert case.force
    assert case.traction
    assert case.displacement
    assert case.gravity is not None
    assert {probe.type for probe in case.probe} == {
        "rotation",
        "displacement",
        "reaction",
        "volume",
    }
    results = result.summary["results"]
    contact = results["contacts"]["pair_0"]
    # The foot of the block carries what the finger presses on it, and its own weight.
    block = 0.016 * 0.016 * 0.008 * 1200 * 9.8
    assert results["push_force_N"] == pytest.approx(contact["force_N"][2] + block, rel=2e-3)
    assert contact["force_N"][2] > 0.0
    assert results["air_ml"] > 1.664  # more than the 52 x 8 x 4 mm3 it started with
