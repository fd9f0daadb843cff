"""The table of a gait in a case, and its picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import TypeAdapter, ValidationError

from flexapod.app.plots_gait import plot_figure8, plot_gait, wrapped
from flexapod.app.spec_gait import GaitSpec
from flexapod.dynamics.gait import GaitHold, GaitPairs, GaitPronk, GaitWalk
from flexapod.dynamics.gait_tables import GaitTable

DEG = math.pi / 180.0
PAPER = (60 * DEG, 30 * DEG, 3.0, 1.2)
READER: TypeAdapter[Any] = TypeAdapter(GaitSpec)


def _gait(**table: Any) -> Any:
    return READER.validate_python(table).gait()


def test_defaults_are_the_papers() -> None:
    assert _gait(type="tripod") == GaitWalk.tripod(*PAPER)
    assert _gait(type="together") == GaitWalk.together(*PAPER)
    assert _gait(type="spot_turn") == GaitWalk.spot_turn(*PAPER)
    assert _gait(type="pronk") == GaitPronk(60 * DEG, -30 * DEG, 0.5, 0.2)
    assert _gait(type="pairs") == GaitPairs()
    assert _gait(type="hold") == GaitHold()


def test_every_key_arrives() -> None:
    turning = {"turn_centre": "5 deg", "turn_time": "0.2 s", "direction": "backward"}
    clock = {"extent": "50 deg", "centre": "20 deg", "period": "2 s", "slow_time": "800 ms"}
    begin = {"start_angle": "90 deg", "start": "0.5 s"}
    four = (50 * DEG, 20 * DEG, 2.0, 0.8)
    options: Any = {
        "turn_centre": 5 * DEG,
        "turn_time": 0.2,
        "direction": -1,
        "start_angle": 90 * DEG,
        "start": 0.5,
    }
    made = _gait(type="tripod", lead="right", **clock, **turning, **begin)
    assert made == GaitWalk.tripod(*four, lead="right", **options)
    made = _gait(type="together", **clock, **turning, **begin)
    assert made == GaitWalk.together(*four, **options)
    made = _gait(
        type="spot_turn", direction="right", legs="together", reversal="same", **clock, **begin
    )
    assert made == GaitWalk.spot_turn(
        *four,
        towards="right",
        phases=(0.0,) * 6,
        reversal="same",
        start_angle=90 * DEG,
        start=0.5,
    )
    made = _gait(
        type="pronk", stroke="slow_time", profile="smooth", begins="front", start="1 s", **clock
    )
    assert made == GaitPronk(*four, "slow_time", "smooth", "front", 1.0)
    made = _gait(
        type="pairs", interval="1 s", down_time="0.3 s", hold_time="0 s", up_time="0.4 s",
        order=["back", "front"], rounds=2, rest_angle="170 deg", push_angle="10 deg",
        returns="onward", start="1 s",
    )  # fmt: skip
    assert made == GaitPairs(
        1.0, 0.3, 0.0, 0.4, ("back", "front"), 1.0, 2, 170 * DEG, 10 * DEG, "onward"
    )
    assert _gait(type="pairs", order="back") == GaitPairs(order=("back",))
    assert _gait(type="hold", angle="0 deg") == GaitHold(0.0)


def test_a_table_of_legs() -> None:
    legs = {
        "145": [["0 s", "180 deg"], ["1 s", "540 deg"]],
        "236": [["0 s", "180 deg"]],
    }
    gait = _gait(type="table", legs=legs, repeat=True, start="2 s")
    assert isinstance(gait, GaitTable)
    expected = [630, 180, 180, 630, 630, 180]
    assert gait.targets(3.25) / DEG == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize(
    "table",
    [
        {"type": "tripod", "turn_time": "0.1 s", "start_angle": "33.3 deg"},
        {"type": "pairs", "rounds": 2, "push_angle": "360 deg"},
        {"type": "table", "legs": {"123456": [["0 s", "0 deg"], ["1 s", "1 rad"]]}},
        {
            "type": "sensed",
            "move": [
                {"legs": "3456", "start": "1 s", "angles": [["0 s", "1 rad"], ["1 s", "0 deg"]]},
                {"legs": "12", "turn": "3.3 deg", "angles": [["0 s", "1 rad"]]},
            ],
        },
    ],
)
def test_what_is_written_back_reads_the_same(table: dict[str, Any]) -> None:
    spec = READER.validate_python(table)
    assert READER.validate_python(spec.model_dump(mode="json")) == spec


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (
            {"type": "trot"},
            "'tripod', 'together', 'spot_turn', 'pronk', 'pairs', 'table', 'sensed', 'hold'",
        ),
        ({"type": "tripod", "extent": 60}, "write an angle with its unit"),
        ({"type": "tripod", "extent": "0 deg"}, "extent must lie between 0 and 360 deg"),
        ({"type": "tripod", "slow_time": "3 s"}, "slow_time must lie between 0 and the period"),
        ({"type": "together", "turn_time": "-1.2 s"}, "slow_time must lie"),
        ({"type": "together", "lead": "left"}, "Extra inputs"),
        ({"type": "spot_turn", "direction": "forward"}, "'left' or 'right'"),
        ({"type": "pronk", "start": "-1 s"}, "must be >= 0, got -1"),
        ({"type": "pairs", "order": ["tail"]}, "'front', 'middle' or 'back'"),
        ({"type": "pairs", "order": ["back", "back"]}, "different ones"),
        ({"type": "table", "legs": {"1": [["0 s", "0 deg"]]}}, "leaves out legs 2, 3, 4, 5, 6"),
        ({"type": "sensed", "move": [{"legs": "x", "angles": [], "start": "0 s"}]}, "by digits"),
        ({"type": "sensed", "move": [{"legs": "1", "angles": [], "start": "0 s"}]}, "need pairs"),
        (
            {"type": "sensed", "move": [{"legs": "1", "angles": [["0 s", "0 deg"]]}]},
            "either at a time or at a turn",
        ),
    ],
)
def test_what_is_refused(table: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError) as caught:
        READER.validate_python(table)
    message = str(caught.value)
    assert text in message
    assert "gait: " not in message


# --------------------------------------------------------------------------- pictures


def test_wrapped_angles_by_hand() -> None:
    # 200 to 440 deg in 4 s passes 270 deg, the seam, at 7/6 s, and the other way round at 17/6 s.
    times = np.arange(5.0)
    x, y = wrapped(times, 200.0 + 60.0 * times)
    edge = 7.0 / 6.0
    assert x == pytest.approx([0, 1, edge, edge, edge, 2, 3, 4])
    assert y == pytest.approx([200, 260, 270, np.nan, -90, -40, 20, 80], nan_ok=True)
    x, y = wrapped(times, 440.0 - 60.0 * times)
    edge = 17.0 / 6.0
    assert x == pytest.approx([0, 1, 2, edge, edge, edge, 3, 4])
    assert y == pytest.approx([80, 20, -40, -90, np.nan, 270, 260, 200], nan_ok=True)


def test_no_streaks_over_many_turns() -> None:
    gait = GaitWalk.spot_turn(*PAPER)
    times = np.linspace(0.0, 30.0, 4000)
    for leg in (0, 1):
        angles = np.degrees([gait.targets(float(time))[leg] for time in times])
        x, y = wrapped(times, angles)
        # Ten turns from 180 deg cross the seam ten times.
        assert np.count_nonzero(np.isnan(y)) == 10
        drawn = np.diff(y)
        assert np.nanmax(np.abs(drawn)) < 2.0
        assert (np.diff(x) >= 0.0).all()
        kept = np.isin(times, x)
        assert kept.all()
        assert np.nanmin(y) == -90.0
        assert np.nanmax(y) == 270.0


def test_pictures_are_written_whole(tmp_path: Path) -> None:
    plot_figure8(tmp_path / "figure8.png")
    plot_gait(GaitPairs(rounds=2), tmp_path / "pairs.png", title="Pairs")
    plot_gait(GaitHold(), tmp_path / "hold.png")
    for name in ("figure8", "pairs", "hold"):
        picture = np.asarray(Image.open(tmp_path / f"{name}.png").convert("L"))
        assert picture.shape[1] == 1344
        assert np.count_nonzero(picture < 200) > 2000  # lines and letters
    assert len(list(tmp_path.iterdir())) == 3
