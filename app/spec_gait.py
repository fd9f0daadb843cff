"""The table of a gait: what the six legs of a robot do over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from flexapod.app.spec_base import Table, default_text, one_or_many
from flexapod.core.errors import InputError
from flexapod.core.units import Angle, PositiveTime, Time

if TYPE_CHECKING:
    from flexapod.dynamics.gait import Gait, GaitHold, GaitPairs, GaitPronk, GaitWalk
    from flexapod.dynamics.gait_tables import GaitSensed, GaitTable


def _not_negative(value: float) -> float:
    if value < 0.0:
        raise ValueError(f"must be >= 0, got {value:g}")
    return value


NotNegativeTime = Annotated[Time, AfterValidator(_not_negative)]
Pair = Literal["front", "middle", "back"]


class _GaitTableBase(Table):
    """What the tables of all gaits share: they are tried out when they are read."""

    def gait(self) -> Gait:
        """The gait itself.

        Raises
        ------
        InputError
            What is wrong, by the names of the table's keys.
        """
        raise NotImplementedError

    @model_validator(mode="after")
    def _can_be_made(self) -> _GaitTableBase:
        try:
            self.gait()
        except InputError as error:
            # The case names the place itself.
            raise ValueError(str(error).removeprefix("gait: ")) from None
        return self


class _Started(_GaitTableBase):
    start: NotNegativeTime = Field(
        default=default_text("0 s"),
        description="When the legs begin; until then they are held where the gait begins.",
    )


class _Turning(_Started):
    """A leg that turns round by {theta_s, theta_0, t_c, t_s}; the defaults are the paper's."""

    extent: Angle = Field(
        default=default_text("60 deg"),
        description="theta_s, the part of a turn that takes slow_time, with the foot down.",
    )
    centre: Angle = Field(
        default=default_text("30 deg"),
        description="theta_0, the middle of that part: from straight down, positive to the back.",
    )
    period: PositiveTime = Field(default=default_text("3 s"), description="t_c, of a whole turn.")
    slow_time: PositiveTime = Field(
        default=default_text("1.2 s"), description="t_s; the rest of the turn takes the rest."
    )
    start_angle: Angle = Field(
        default=default_text("180 deg"),
        description="Where all legs begin: each waits there until its clock passes that angle. "
        "180 deg, straight up, is the paper's.",
    )

    def _settings(self) -> dict[str, Any]:
        """What every such gait takes, by the names of `GaitWalk`'s makers."""
        return {
            "extent": self.extent,
            "centre": self.centre,
            "period": self.period,
            "slow_time": self.slow_time,
            "start_angle": self.start_angle,
            "start": self.start,
        }


class _Walking(_Turning):
    turn_centre: Angle = Field(
        default=default_text("0 deg"),
        description="To turn while walking: added to centre on the left, taken off on the right.",
    )
    turn_time: Time = Field(
        default=default_text("0 s"),
        description="Likewise of slow_time: added on the left, taken off on the right.",
    )
    direction: Literal["forward", "backward"] = Field(
        default="forward",
        description="Backward, angles have the other sign, the slow phase lies about -centre.",
    )

    def _settings(self) -> dict[str, Any]:
        return {
            **super()._settings(),
            "turn_centre": self.turn_centre,
            "turn_time": self.turn_time,
            "direction": 1 if self.direction == "forward" else -1,
        }


class GaitTripodSpec(_Walking):
    """Walks with legs 1, 4, 5 and legs 2, 3, 6 in turn; odd legs are on the left."""

    type: Literal["tripod"]
    lead: Literal["left", "right"] = Field(
        default="left",
        description="Which tripod begins: 1, 4, 5, with two legs on the left (assumed, since the "
        "paper does not say), or 2, 3, 6, with two on the right.",
    )

    def gait(self) -> GaitWalk:
        """See `GaitWalk.tripod`."""
        from flexapod.dynamics.gait import GaitWalk

        return GaitWalk.tripod(**self._settings(), lead=self.lead)


class GaitTogetherSpec(_Walking):
    """Walks with all six legs in step."""

    type: Literal["together"]

    def gait(self) -> GaitWalk:
        """See `GaitWalk.together`."""
        from flexapod.dynamics.gait import GaitWalk

        return GaitWalk.together(**self._settings())


class GaitSpotTurnSpec(_Turning):
    """Turns on the spot: the legs of the two sides go round in opposite directions."""

    type: Literal["spot_turn"]
    direction: Literal["left", "right"] = Field(
        default="left",
        description="Where the robot turns: to the left, the left legs walk backward.",
    )
    legs: Literal["tripod", "together"] = Field(
        default="tripod",
        description="In tripods, the paper's most common gait (assumed), or all in step.",
    )
    reversal: Literal["mirrored", "same"] = Field(
        default="mirrored",
        description="What the side that goes backward does: its angles have the other sign, so "
        "its slow phase lies about -centre (assumed: both sides then push alike), or its slow "
        "phase stays the same part of the turn and is swept the other way. The paper says only "
        "that the directions are opposite.",
    )

    def gait(self) -> GaitWalk:
        """See `GaitWalk.spot_turn`."""
        from flexapod.dynamics.gait import LEG_COUNT, TRIPODS, GaitWalk

        return GaitWalk.spot_turn(
            **self._settings(),
            towards=self.direction,
            phases=TRIPODS["left"] if self.legs == "tripod" else (0.0,) * LEG_COUNT,
            reversal=self.reversal,
        )


class GaitPronkSpec(_Started):
    """All six legs swing to and fro together; the defaults are the paper's on the ground."""

    type: Literal["pronk"]
    extent: Angle = Field(default=default_text("60 deg"), description="theta_s, of the swing.")
    centre: Angle = Field(
        default=default_text("-30 deg"),
        description="theta_0, its middle: from straight down, negative to the front.",
    )
    period: PositiveTime = Field(default=default_text("0.5 s"), description="t_c, to and fro.")
    slow_time: PositiveTime = Field(
        default=default_text("0.2 s"), description="t_s; which way it is, stroke says."
    )
    stroke: Literal["rest", "slow_time"] = Field(
        default="rest",
        description="What the push from the front to the back takes: the rest of the period "
        "(assumed, as the paper calls t_s the time from aerial to touchdown), or slow_time.",
    )
    profile: Literal["linear", "smooth"] = Field(
        default="linear",
        description="At one speed each way, or half a cosine, at rest at both ends.",
    )
    begins: Literal["back", "front"] = Field(
        default="back",
        description="Where the legs wait and begin. Assumed, the back, which with the defaults is "
        "straight down: the robot stands before it jumps.",
    )

    def gait(self) -> GaitPronk:
        """See `GaitPronk`."""
        from flexapod.dynamics.gait import GaitPronk

        return GaitPronk(
            self.extent,
            self.centre,
            self.period,
            self.slow_time,
            self.stroke,
            self.profile,
            self.begins,
            self.start,
        )


class GaitPairsSpec(_Started):
    """One pair of legs after the other pushes, to roll a curled body."""

    type: Literal["pairs"]
    interval: PositiveTime = Field(
        default=default_text("0.8 s"), description="From one pair to the next."
    )
    down_time: PositiveTime = Field(
        default=default_text("0.5 s"),
        description="Of the way out. This, hold_time and up_time are assumed, since the paper "
        "gives none: servos of this torque take about half a second for half a turn.",
    )
    hold_time: NotNegativeTime = Field(
        default=default_text("0.1 s"), description="Of the stay at push_angle."
    )
    up_time: PositiveTime = Field(default=default_text("0.5 s"), description="Of the way back.")
    order: tuple[Pair, ...] = Field(
        default=("front", "middle", "back"),
        min_length=1,
        description="Which pairs push, in this order (assumed from the front): legs 1 and 2 are "
        "the front pair, 3 and 4 the middle, 5 and 6 the back one.",
    )
    rounds: Annotated[int, Field(ge=1)] = Field(
        default=1, description="How often all of them push."
    )
    rest_angle: Angle = Field(
        default=default_text("180 deg"), description="Where the legs are the rest of the time."
    )
    push_angle: Angle = Field(
        default=default_text("0 deg"),
        description="Where they push. The way is the straight one: 0 deg is reached past the back "
        "(assumed, as the paper counts from 180 to 0), 360 deg past the front.",
    )
    returns: Literal["back", "onward"] = Field(
        default="back",
        description="The way they came (assumed), or on in the same sense to a whole turn.",
    )

    _order = field_validator("order", mode="before")(one_or_many)

    def gait(self) -> GaitPairs:
        """See `GaitPairs`."""
        from flexapod.dynamics.gait import GaitPairs

        return GaitPairs(
            interval=self.interval,
            down_time=self.down_time,
            hold_time=self.hold_time,
            up_time=self.up_time,
            order=self.order,
            start=self.start,
            rounds=self.rounds,
            rest_angle=self.rest_angle,
            push_angle=self.push_angle,
            returns=self.returns,
        )


class GaitTableSpec(_Started):
    """Angles of the legs at given times, linear between them."""

    type: Literal["table"]
    legs: dict[str, tuple[tuple[Time, Angle], ...]] = Field(
        description="By the digits of the legs, pairs of a time after start and an angle, for "
        'example { 145 = [["0 s", "180 deg"], ["1 s", "0 deg"]], 236 = [["0 s", "180 deg"]] }. '
        "Times ascend from 0 s, and each leg is named once.",
    )
    repeat: bool = Field(
        default=False,
        description="Begin anew at the last time of all; each leg must then end where it began, "
        "or whole turns on.",
    )

    def gait(self) -> GaitTable:
        """See `GaitTable.of_legs`."""
        from flexapod.dynamics.gait_tables import GaitTable

        return GaitTable.of_legs(self.legs, repeat=self.repeat, start=self.start)


class MoveSpec(Table):
    """A move of some legs: it begins at a time, or once the robot has rolled so far."""

    legs: str = Field(description='Digits of the legs, for example "34".')
    angles: tuple[tuple[Time, Angle], ...] = Field(
        description="Pairs of the time since it began, ascending from 0 s, and an angle; linear "
        "between, the last one stays. It begins where the move before ended."
    )
    start: NotNegativeTime | None = Field(default=None, description="When it begins.")
    turn: Angle | None = Field(
        default=None,
        description="How far the robot has rolled forward when it begins, whole turns counted.",
    )


class GaitSensedSpec(_GaitTableBase):
    """Moves that begin at a time or by the robot's own turn, as an inertial sensor feels it."""

    type: Literal["sensed"]
    move: tuple[MoveSpec, ...] = Field(
        description="In order; of a leg one begins only after those before have ended."
    )

    def gait(self) -> GaitSensed:
        """See `GaitSensed`."""
        from flexapod.dynamics.gait_tables import GaitSensed, Move

        return GaitSensed(
            tuple(Move.of_legs(m.legs, m.angles, start=m.start, turn=m.turn) for m in self.move)
        )


class GaitHoldSpec(_GaitTableBase):
    """The legs stay where they are."""

    type: Literal["hold"]
    angle: Angle = Field(
        default=default_text("180 deg"), description="Of all legs; 180 deg is straight up."
    )

    def gait(self) -> GaitHold:
        """See `GaitHold`."""
        from flexapod.dynamics.gait import GaitHold

        return GaitHold(self.angle)


GaitSpec = Annotated[
    GaitTripodSpec
    | GaitTogetherSpec
    | GaitSpotTurnSpec
    | GaitPronkSpec
    | GaitPairsSpec
    | GaitTableSpec
    | GaitSensedSpec
    | GaitHoldSpec,
    Field(discriminator="type"),
]


__all__ = [
    "GaitHoldSpec",
    "GaitPairsSpec",
    "GaitPronkSpec",
    "GaitSensedSpec",
    "GaitSpec",
    "GaitSpotTurnSpec",
    "GaitTableSpec",
    "GaitTogetherSpec",
    "GaitTripodSpec",
]
