"""The laws by the names case files use. A new law is one file and one line here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flexapod.core.errors import InputError
from flexapod.materials.law import HyperelasticLaw
from flexapod.materials.mooney_rivlin import MooneyRivlin
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden
from flexapod.materials.yeoh import Yeoh

LAWS: dict[str, Any] = {
    "ogden": Ogden,
    "neo-hooke": NeoHooke,
    "mooney-rivlin": MooneyRivlin,
    "yeoh": Yeoh,
}

# The words of a material table, and how many values each takes (least, most; None = any).
WORDS: dict[str, dict[str, tuple[int, int | None]]] = {
    "ogden": {"mu": (1, None), "alpha": (1, None)},
    "neo-hooke": {"mu": (1, 1)},
    "mooney-rivlin": {"c": (2, 2)},
    "yeoh": {"c": (1, 3)},
}


def make_law(
    model: str, coefficients: Mapping[str, Sequence[float] | float], where: str | None = None
) -> HyperelasticLaw:
    """Return the law `model` from SI coefficients.

    Parameters
    ----------
    model
        One of `LAWS`.
    coefficients
        ogden ``{"mu": [...], "alpha": [...]}`` (mu/alpha convention), neo-hooke ``{"mu": [G]}``,
        mooney-rivlin ``{"c": [c10, c01]}``, yeoh ``{"c": [c1, c2, c3]}`` (c2, c3 may be left
        out); moduli in Pa.
    where
        File and key, for messages.
    """
    if model not in LAWS:
        raise InputError(f'model must be one of {", ".join(LAWS)}; got "{model}"', where)
    words = WORDS[model]
    unknown = sorted(set(coefficients) - set(words))
    missing = sorted(set(words) - set(coefficients))
    if unknown or missing:
        said = [f"unknown: {', '.join(unknown)}"] if unknown else []
        said += [f"missing: {', '.join(missing)}"] if missing else []
        raise InputError(f"{model} takes {', '.join(words)} ({'; '.join(said)})", where)
    values: dict[str, tuple[float, ...]] = {}
    for word, (least, most) in words.items():
        given = coefficients[word]
        row = tuple(float(v) for v in given) if isinstance(given, Sequence) else (float(given),)
        if len(row) < least or (most is not None and len(row) > most):
            allowed = f"{least}" if least == most else f"{least} to {most or 'any number of'}"
            raise InputError(f"{model} takes {allowed} values of {word}, got {len(row)}", where)
        values[word] = row
    law: HyperelasticLaw
    if model == "ogden":
        law = Ogden(values["mu"], values["alpha"])
    elif model == "neo-hooke":
        law = NeoHooke(values["mu"][0])
    else:
        law = LAWS[model](*values["c"])
    return law
