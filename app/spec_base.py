"""What every table of a case file shares."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

Axis = Literal["x", "y", "z"]
Triple = tuple[float, float, float]
Names = tuple[str, ...]


class Table(BaseModel):
    """A table of a case: frozen, and no key but its own."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", populate_by_name=True, validate_default=True
    )


def one_or_many(value: Any) -> Any:
    """A single name stands for a list of one."""
    return (value,) if isinstance(value, str) else value


def default_text(*texts: str) -> Any:
    """A default as a case file writes it; validated like the rest, so the schema can show it."""
    return texts[0] if len(texts) == 1 else texts
