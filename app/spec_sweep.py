"""The table of a sweep: keys that take several values, all combinations run."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from flexapod.app.spec_base import Table

Value = str | bool | int | float

# Of the case itself: what a sweep is of cannot be swept.
_FIXED = ("sweep", "search", "name", "title", "plot", "resolved")


class SweepOverSpec(Table):
    """A key and the values it takes."""

    key: str = Field(description="As --set writes it, for example actuation.interval.")
    values: tuple[Value, ...] = Field(min_length=1, description="As the case would write them.")

    @field_validator("key")
    @classmethod
    def _of_the_motion(cls, key: str) -> str:
        if not key.strip() or key.split(".")[0].strip() in _FIXED:
            raise ValueError(
                f'must name a key of the motion, not of {", ".join(_FIXED)}; got "{key}"'
            )
        return key

    @field_validator("values")
    @classmethod
    def _differ(cls, values: tuple[Value, ...]) -> tuple[Value, ...]:
        names = [str(value) for value in values]
        double = sorted({name for name in names if names.count(name) > 1})
        if double:
            raise ValueError(f"values must differ; written twice: {', '.join(double)}")
        return values


class SweepReferenceSpec(Table):
    """A curve to draw beside: `x` along the last key, in the unit its values are written in."""

    name: str
    x: tuple[float, ...] = Field(min_length=1)
    y: tuple[float, ...] = Field(min_length=1, description="In the unit of the result swept.")

    @model_validator(mode="after")
    def _pairs(self) -> SweepReferenceSpec:
        if len(self.x) != len(self.y):
            raise ValueError(f"x and y must be as many; got {len(self.x)} and {len(self.y)}")
        return self


class SweepSpec(Table):
    """A motion run once for each combination of values, in parallel processes."""

    of: str = Field(description="Result of a run's summary that is collected, e.g. distance_m.")
    result: str = Field(description="Name of the collection in the sweep's summary.")
    over: tuple[SweepOverSpec, ...] = Field(
        min_length=1, description="The results are nested in this order."
    )
    jobs: Annotated[int, Field(ge=1, le=1024)] | None = Field(
        default=None, description="Runs at a time (default: as many as the machine has cores)."
    )
    keep: bool = Field(
        default=False,
        description="Keep frames, pictures and checkpoints of every run in runs/0001 and so on; "
        "else only its case, curve and summary.",
    )
    reference: tuple[SweepReferenceSpec, ...] = ()

    @field_validator("over")
    @classmethod
    def _keys_differ(cls, over: tuple[SweepOverSpec, ...]) -> tuple[SweepOverSpec, ...]:
        keys = [item.key for item in over]
        double = sorted({key for key in keys if keys.count(key) > 1})
        if double:
            raise ValueError(f"keys must differ; swept twice: {', '.join(double)}")
        return over

    @field_validator("result")
    @classmethod
    def _named(cls, result: Any) -> Any:
        if not result.strip():
            raise ValueError('must be a name, for example "distance_by_interval"')
        return result


__all__ = ["SweepOverSpec", "SweepReferenceSpec", "SweepSpec", "Value"]
