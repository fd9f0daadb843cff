"""Named failures and the checks every floor shares.

`InputError` is what the user wrote (exit code 2); `SolverError` carries a `Status`, which is
what the numbers did (exit code 3). `assert` is kept for our own slips.
"""

from __future__ import annotations

import math
from enum import Enum


class Status(Enum):
    """How a solution ended; the value is the sentence shown to the user."""

    DONE = "reached the last load"
    NOT_CONVERGED = "Newton's method did not converge within its iteration limit"
    NOT_FINITE = "a residual or displacement became NaN or infinite"
    INVERTED_ELEMENT = "an element turned inside out"
    SINGULAR = "the tangent matrix could not be factorised"
    STEP_TOO_SMALL = "the load increment fell below its lower limit"
    TOO_MANY_INCREMENTS = "the path needed more increments than allowed"
    FELL_THROUGH = "a body is deeper in the ground than contact can be"
    UNSTABLE_STEP = "the fixed time step is no longer stable"
    INTERRUPTED = "the run was stopped by the user"


class FlexapodError(Exception):
    """Base of every error this package raises on purpose."""


class InputError(FlexapodError, ValueError):
    """What the user wrote cannot be used: rule, name, value and remedy.

    Parameters
    ----------
    message
        What is wrong and what was expected.
    where
        File, line or key it was found at, for example ``"curl.toml: mesh.size"``.
    """

    def __init__(self, message: str, where: str | None = None) -> None:
        self.where = where
        super().__init__(f"{where}: {message}" if where else message)


class SolverError(FlexapodError, RuntimeError):
    """A solution that could not go on; what was computed before it is kept by the caller."""

    def __init__(self, status: Status, message: str) -> None:
        self.status = status
        self.text = message
        super().__init__(f"{message} ({status.name.lower()}: {status.value})")


def check_positive(name: str, value: float, unit: str = "", where: str | None = None) -> float:
    """Return `value` if it is finite and > 0, else raise `InputError`."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} must be finite and > 0, got {value:g} {unit}".rstrip(), where)
    return value


def check_finite(name: str, value: float, unit: str = "", where: str | None = None) -> float:
    """Return `value` if it is finite, else raise `InputError`."""
    if not math.isfinite(value):
        raise InputError(f"{name} must be finite, got {value} {unit}".rstrip(), where)
    return value
