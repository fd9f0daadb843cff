"""Ring robots from case files: tables and refusals, model, rows, frames, checkpoints, jumps."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from flexapod.app import motion as motion_module
from flexapod.app import plots
from flexapod.app.case import LoadedCase, case_schema, load_case, parse_case
from flexapod.app.motion_flight import flight_results, flights
from flexapod.app.motion_model import Motion, assemble_motion
from flexapod.app.run import run_case
from flexapod.core.errors import InputError, Status

RING: dict[str, Any] = {
    "ring": {},
    "actuation": {"pattern": "BF", "interval": "40 ms"},
    "dynamics": {"duration": "100 ms", "interval": "10 ms", "frames": 2, "checkpoint": 2},
    "gravity": {},
    "contact": [{"type": "ground", "surface": "shell"}],
}


@pytest.fixture(autouse=True)
def _matplotlib_only(monkeypatch: pytest.MonkeyPatch) -> None:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")


def _table(**changes: Any) -> dict[str, Any]:
    table = {**RING, **changes}
    return {key: value for key, value in table.items() if value is not None}


def _loaded(**changes: Any) -> LoadedCase:
    return LoadedCase(parse_case(_table(**changes), "x.toml"), "x.toml", Path())


def _motion(**changes: Any) -> Motion:
    return assemble_motion(_loaded(**changes), None, lambda text: None)


def _rows(folder: Path) -> list[dict[str, float]]:
    with (folder / "curve.csv").open() as stream:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(stream)]


# --------------------------------------------------------------------------- tables


def test_defaults_are_the_papers() -> None:
    case = parse_case(RING, "x.toml")
    assert case.ring is not None
    assert case.coils is not None  # there without their table
    sizes = case.ring.sizes
    assert (sizes.diameter, sizes.mass, sizes.mass_of_hub, sizes.node_count) == (
        0.04,
        3e-3,
        3e-4,
        32,
    )
    assert (sizes.stretch_stiffness, sizes.stretch_damping) == (500.0, 0.1)
    assert sizes.bend_stiffness == 0.0015
    coils = case.coils
    assert (coils.stiffness, coils.damping, coils.flow_damping) == (50.0, 0.1, 10.0)
    assert (coils.limit, coils.rate_on, coils.rate_off, coils.largest_force) == (
        0.016, 0.15, 0.15, 0.15
    )  # fmt: skip


TABLE = {"A": [["0 s", "50 ms"]]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ring": {"nodes": 12}}, "ring.nodes: must be a multiple of 8; got 12"),
        ({"ring": {"nods": 8}}, "ring.nods: unknown key (did you mean nodes?)"),
        ({"ring": {"stretch_stiffness": "-1 N/m"}}, "ring.stretch_stiffness: stiffness must be"),
        ({"ring": {"bend_stiffness": "1 N/m"}}, '"N/m" does not measure a bending stiffness'),
        ({"ring": {"mass": "0.1 g"}}, "ring: hub_mass must be less than mass"),
        ({"ring": {"shell": "solid", "shape": "sphere"}}, "a sphere has shell"),
        ({"ring": {"solid": {}}}, '[ring.solid] belongs to shell = "solid"'),
        ({"ring": {"shell": "solid", "rest_curvature": 0.5}}, "ring: rest_curvature"),
        ({"coils": {"damping": "-1 N s/m"}}, "coils.damping: must be >= 0, got -1"),
        ({"coils": {"flow_damping": "0 N s/m"}}, "coils.flow_damping: must be > 0, got 0"),
        ({"coils": {"flow": "some"}}, "coils.flow: must be 'full' or 'excess'; got 'some'"),
        ({"actuation": {}}, "actuation: write exactly one of pattern and table"),
        ({"actuation": {"pattern": "BX"}}, "actuation.pattern: it names X, which cannot move"),
        ({"actuation": {"pattern": "BI"}}, "actuation.pattern: it names I, which cannot move"),
        ({"actuation": {"pattern": "ABCDEFGH"}}, "actuation.pattern: it names all eight coils"),
        (
            {"actuation": {"pattern": "BF", "interval": "1 s"}},
            "actuation.interval: interval must be shorter than duration",
        ),
        (
            {"actuation": {"pattern": "BF", "interval": "5 ms"}},
            "actuation.interval: must not be shorter than dynamics.interval, 0.01 s",
        ),
        ({"actuation": {"table": {"J": [["0 s", "1 ms"]]}}}, "actuation.table.J: no coil is"),
        ({"actuation": {"table": {"A": [["0 s", "1 s"]]}}}, "actuation.table.A: off at 1 s lies"),
        ({"actuation": {"table": TABLE, "interval": "1 s"}}, "interval belongs to a pattern"),
        ({"actuation": {"pattern": "BF", "interval": "40 ms", "rings": [2]}}, "actuation.rings"),
        ({"dynamics": None}, "a case with [ring] moves: it needs [dynamics] with a duration"),
        ({"mesh": {"builder": "curl"}}, "a case with [ring] cannot have mesh"),
        ({"contact": [{"type": "self", "surface": "shell"}]}, 'contact of type "self"'),
        ({"contact": [{"type": "ground", "surface": "outer"}]}, 'its surface "shell", got outer'),
        ({"contact": 2 * RING["contact"]}, "a ring touches one ground"),
        ({"ring": None}, "mesh: required, but missing"),
        (
            {"ring": {"shell": "solid"}, "coils": {"end_width": "8 mm"}},
            'coils.end_width: belongs to a ring of shell = "elements"',
        ),
        (
            {"search": {"key": "contact.0.slope", "low": "0 deg", "high": "1 deg",
                        "tolerance": "1 deg", "distance": "1 mm", "patterns": ["BG"]}},
            'search: patterns and jobs belong to goal = "climb"',
        ),
    ],
)  # fmt: skip
def test_refusals_name_the_key(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        parse_case(_table(**changes), "x.toml")
    assert message in str(error.value)


def test_only_a_ring_has_coils() -> None:
    table = {"mesh": {"builder": "curl"}, "material": [{"use": "dragon-skin-20-sospider"}],
             "gravity": {}, "coils": {}}  # fmt: skip
    with pytest.raises(InputError, match=r"only a case with \[ring\] has coils"):
        parse_case(table, "x.toml")


def test_the_schema_knows_a_case_without_mesh() -> None:
    schema = case_schema()
    assert {"required": ["ring"]} in schema["anyOf"]
    nodes = schema["$defs"]["RingSpec"]["properties"]["nodes"]
    assert (nodes["default"], nodes["multipleOf"]) == (32, 8)


# --------------------------------------------------------------------------- model


def test_a_ring_lies_on_the_slope_with_its_first_coil_down() -> None:
    motion = _motion(contact=[{"type": "ground", "surface": "shell", "slope": "20 deg"}])
    x, model = motion.state.x, motion.model
    assert motion.mass == pytest.approx(3e-3, rel=1e-12)
    # Up the normal of the slope; the lowest node touches it in the origin's plane.
    normal = np.array([np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))])
    height = x @ normal
    assert height.min() == pytest.approx(0.0, abs=1e-9)
    hub = motion.ring.hub if motion.ring is not None else -1
    assert height[hub] == pytest.approx(0.02, abs=1e-9)
    assert model.lines is not None
    foot = model.lines.lines.ends[32][1]  # of coil A, behind the 32 segments of the shell
    assert height[foot] == pytest.approx(0.0, abs=1e-9)
    assert model.fixed[:, 1].all() and not model.fixed[:, 0].any()


def test_coils_are_those_the_drive_names() -> None:
    motion = _motion()
    assert motion.ring is not None
    assert motion.ring.coils == tuple("ABCDEFGH")
    jumper = _motion(actuation={"table": {"A": [["0 s", "50 ms"]], "I": [["10 ms", "20 ms"]]}})
    assert jumper.ring is not None and jumper.model.lines is not None
    assert jumper.ring.coils == tuple("ABCDEFGHI")
    assert len(jumper.model.lines.lines) == 32 + 9
    commands = jumper.model.lines.coils.actuation  # type: ignore[union-attr]
    assert commands.on(0.015).tolist() == [True, *7 * [False], True]
    passive = _motion(actuation=None)
    assert not passive.model.lines.coils.actuation.states.any()  # type: ignore[union-attr]


def test_a_coil_may_end_on_a_length_of_shell() -> None:
    """8 mm: one element of 3.9 mm on either side; the hub's end stays one node."""
    lines = _motion(coils={"end_width": "8 mm"}).model.lines
    assert lines is not None
    ends = {int(two[len(two) // 2]): two.tolist() for one, two in lines.lines.ends[32:]}
    assert ends[0] == [31, 0, 1] and ends[8] == [7, 8, 9] and len(ends) == 8
    assert all(len(one) == 1 for one, _ in lines.lines.ends[32:])


def test_a_sphere_shares_the_coils_where_its_rings_cross() -> None:
    motion = _motion(
        ring={"shape": "sphere", "nodes": 8},
        actuation={"pattern": "A", "interval": "40 ms", "rings": [1, 3]},
    )
    assert motion.ring is not None and motion.model.lines is not None
    # Three rings of eight spokes; six of the directions are shared by two.
    assert len(motion.ring.coils) == 3 * 8 - 6
    assert motion.mass == pytest.approx(3 * 2.7e-3 + 0.3e-3, rel=1e-12)
    commands = motion.model.lines.coils.actuation  # type: ignore[union-attr]
    on = [name for name, on in zip(motion.ring.coils, commands.on(0.0), strict=True) if on]
    # Straight down is A of the ring in x-z and of that in y-z: one coil.
    assert on == ["A1"]
    later = [name for name, on in zip(motion.ring.coils, commands.on(0.05), strict=True) if on]
    assert later == ["B1", "B3"]
    assert not motion.model.fixed.any()


def test_a_solid_ring_weighs_and_stands_like_the_other() -> None:
    counts = {"around": 16, "through": 2, "across": 2}
    motion = _motion(ring={"shell": "solid", "solid": counts})
    assert motion.mass == pytest.approx(3e-3, rel=1e-12)
    assert motion.size == (64, 16 * 9 + 1, 8)
    assert motion.ring is not None
    assert motion.state.x[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    spokes = motion.state.lines["length"]
    assert spokes == pytest.approx(0.02, rel=1e-12)
    # Only the middle plane is held: the shell may bulge sideways.
    assert motion.model.fixed[:, 1].sum() == 16 * 3 + 1


def test_held_robots_begin_with_their_coils_on() -> None:
    table = {"pattern": "A", "interval": "40 ms", "held": "0.2 s"}
    motion = _motion(
        actuation=table, contact=[{"type": "ground", "surface": "shell", "slope": "20 deg"}]
    )
    state = motion.state
    # D_on t, and no other coil; at the last forces, a step of some 40 us before the end.
    assert state.lines["active"] == pytest.approx([0.15 * 0.2, *7 * [0.0]], rel=1e-3)
    assert (state.time, state.step_count) == (0.0, 0)
    assert not state.v.any()
    assert not state.lines["spent"].any()
    # It did not roll down: less than the sag of a ring of 3 g.
    assert abs(state.x[:, 0] - motion.model.nodes[:, 0]).max() < 2e-3


# --------------------------------------------------------------------------- runs


def test_a_ring_writes_what_it_promises(tmp_path: Path) -> None:
    out = tmp_path / "r"
    result = run_case(_loaded(), out)
    assert result.status is Status.DONE, result.message
    rows = _rows(out)
    assert len(rows) == 11
    heads = {"hub_x_mm", "lines_J", "coil_work_J", "rheology_loss_J", "coil_A_force_mN",
             "coil_H_on", "ground_0_force_N", "hub_speed_m_s"}  # fmt: skip
    assert heads <= rows[0].keys()
    # Coils B and F for 40 ms, then C and G; the force of B rises by D_on and falls by D_off.
    assert [row["coil_B_on"] for row in rows[:8]] == [1, 1, 1, 1, 0, 0, 0, 0]
    assert [row["coil_C_on"] for row in rows[:8]] == [0, 0, 0, 0, 1, 1, 1, 1]
    active = [row["coil_B_active_mN"] for row in rows[:8]]
    # 10 digits of a CSV.
    assert active == pytest.approx([0, 1.5, 3, 4.5, 6, 4.5, 3, 1.5], rel=1e-8, abs=1e-9)
    for row in rows:
        parts = row["stretch_J"] + row["coils_J"] + row["bend_J"]
        assert parts == pytest.approx(row["lines_J"], rel=1e-8, abs=1e-15)
    results = json.loads((out / "summary.json").read_text())["results"]
    assert results["jump_height_m"] == 0.0
    # The baseline of 10 s of crawling is 2e-6; a tenth of a second has less to compare with.
    assert results["energy_balance"] < 1e-3
    assert results["mass_kg"] == pytest.approx(3e-3, rel=1e-12)
    frame = meshio.read(out / "fields" / "lines_0001.vtu")
    assert len(frame.cells[0].data) == 32 + 8
    assert {"coil", "on", "active_force", "force", "elongation"} <= frame.cell_data.keys()
    again = load_case(str(out / "case.resolved.toml"))
    assert again.case.ring == _loaded().case.ring


def test_a_broken_off_ring_goes_on_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = _loaded()
    run_case(loaded, tmp_path / "whole")
    record = motion_module.Recorder.record

    def stop(self: Any, state: Any) -> None:
        record(self, state)
        if state.interval == 7:
            raise KeyboardInterrupt

    monkeypatch.setattr(motion_module.Recorder, "record", stop)
    assert run_case(loaded, tmp_path / "r").status is Status.INTERRUPTED
    monkeypatch.setattr(motion_module.Recorder, "record", record)
    assert run_case(loaded, tmp_path / "r", resume=True).status is Status.DONE
    assert _rows(tmp_path / "r") == _rows(tmp_path / "whole")


def test_a_mirrored_robot_goes_the_other_way() -> None:
    # The mirror image of a robot at x = 0 is that with its letters the other way round.
    ends = []
    for direction in ("clockwise", "counter-clockwise"):
        from flexapod.dynamics.integrator import Options, march

        motion = _motion(ring={"letters_direction": direction})
        march(motion.model, motion.state, motion.work, 10, Options(0.01))
        assert motion.ring is not None
        ends.append(motion.state.x[motion.ring.hub])
    # Sums in another order: rounding grows with the steps, some three thousand of them.
    assert ends[0][0] == pytest.approx(-ends[1][0], abs=1e-9)
    assert abs(ends[0][0]) > 1e-6
    assert ends[0][2] == pytest.approx(ends[1][2], abs=1e-9)


# --------------------------------------------------------------------------- jumps


def _flight(speed: float, height: float, stored: float) -> list[dict[str, float]]:
    """Rows of a mass of 2 kg that stands, is thrown up at `speed` and lands; g = 10 m/s2."""
    rows = []
    for k in range(13):
        t = 0.1 * k - 0.2
        z = speed * t - 5.0 * t * t if 0.0 <= t <= speed / 5.0 else 0.0
        up = 0.0 < t < speed / 5.0 - 1e-9
        rows.append(
            {
                "time_s": 0.1 * k,
                "centre_x_mm": 1000.0 * max(t, 0.0),
                "centre_y_mm": 0.0,
                "centre_z_mm": 1000.0 * (height + z),
                "speed_m_s": abs(speed - 10.0 * t) if (t >= 0.0 and up) or t == 0.0 else 0.0,
                "weight_J": 20.0 * (height + z),
                "lines_J": stored if t < 0.0 else 0.0,
                "ground_0_points": 0.0 if up else 3.0,
            }
        )
    return rows


def test_a_thrown_mass_is_seen_to_fly() -> None:
    rows = _flight(speed=4.0, height=0.5, stored=32.0)
    assert flights(rows) == [(2, 10)]
    results = flight_results(rows, mass=2.0)
    assert results["jump_height_m"] == pytest.approx(0.8)  # v^2 / 2 g
    assert results["flight_time_s"] == pytest.approx(0.8)  # 2 v / g
    assert results["jump_distance_m"] == pytest.approx(0.8)
    assert results["release_energy_J"] == 32.0
    assert results["flight_energy_J"] == pytest.approx(16.0)  # m v^2 / 2
    assert results["flight_share"] == pytest.approx(0.5)


def test_what_never_leaves_the_ground_does_not_jump() -> None:
    rows = [{**row, "ground_0_points": 1.0} for row in _flight(4.0, 0.5, 1.0)]
    assert flights(rows) == []
    assert flight_results(rows, 2.0)["jump_height_m"] == 0.0
