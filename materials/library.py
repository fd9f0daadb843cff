"""Named materials with sources, and material files written by ``flexapod fit --out``."""

from __future__ import annotations

import tomllib
import warnings
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from flexapod.core.errors import InputError
from flexapod.core.units import read_quantity
from flexapod.materials.law import SolidMaterial
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.registry import WORDS, make_law

# What a casting silicone weighs (Smooth-On data sheets: specific gravity 1.07 to 1.08).
DEFAULT_DENSITY = 1070.0  # [kg/m3]
DEFAULT_POISSON = 0.499

_DESCRIPTIVE = {"title", "source", "note", "assumed", "name", "fit"}


@dataclass(frozen=True)
class LibraryEntry:
    """What the library says about a material besides its numbers."""

    name: str
    title: str
    source: str
    note: str = ""
    assumed: tuple[str, ...] = ()


@lru_cache(maxsize=1)
def _library() -> dict[str, dict[str, Any]]:
    text = files("flexapod.materials").joinpath("library.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def library_entries() -> tuple[LibraryEntry, ...]:
    """Return every named material, in the order of the library file."""
    return tuple(
        LibraryEntry(
            name,
            table["title"],
            table["source"],
            table.get("note", ""),
            tuple(table.get("assumed", ())),
        )
        for name, table in _library().items()
    )


def load_material(
    name_or_path: str | Path, *, density: float | None = None, poisson: float | None = None
) -> SolidMaterial:
    """Return a material by library name, or from a material file.

    Parameters
    ----------
    name_or_path
        A name of `library_entries`, or the path of a ``.toml`` file (one flat table in the same
        words, as ``flexapod fit --out`` writes it).
    density
        Density [kg/m3] to use instead of the file's; a fit file may have none.
    poisson
        Poisson's ratio to use instead of the file's (it sets the bulk modulus).

    Warns
    -----
    UserWarning
        If neither the file nor the caller gives a density: `DEFAULT_DENSITY` is taken.
    """
    text = str(name_or_path)
    table = _library().get(text)
    where, name = f'material "{text}"', text
    if table is None:
        path = Path(name_or_path)
        if path.suffix.lower() != ".toml" or not path.is_file():
            what = "no such file" if path.suffix.lower() == ".toml" else "no such name"
            raise InputError(
                f"{what}: give a library name ({', '.join(_library())}) or the path of a "
                "material .toml written by 'flexapod fit --out'",
                where,
            )
        where = str(path)
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"is not a TOML file: {error}", where) from None
        name = str(table.get("name", path.stem))
    return material_from_table(table, where, name, density=density, poisson=poisson)


def material_from_table(
    table: dict[str, Any],
    where: str,
    name: str,
    *,
    density: float | None = None,
    poisson: float | None = None,
) -> SolidMaterial:
    """Return the material a table in the words of `library.toml` describes."""
    model = table.get("model")
    if not isinstance(model, str):
        raise InputError('needs model = "ogden" | "neo-hooke" | ...', where)
    words = {"youngs_modulus"} if model == "linear" else set(WORDS.get(model, {}))
    unknown = sorted(set(table) - _DESCRIPTIVE - words - {"model", "density", "poisson"})
    if unknown and words:
        allowed = ", ".join(sorted(words | {"density", "poisson"} | _DESCRIPTIVE))
        raise InputError(f"unknown key {', '.join(unknown)}; allowed: {allowed}", where)

    if poisson is None:
        poisson = _number(table.get("poisson", DEFAULT_POISSON), f"{where}: poisson")
    if density is None:
        if "density" in table:
            density = read_quantity(table["density"], "kg/m^3", f"{where}: density")
        else:
            density = DEFAULT_DENSITY
            warnings.warn(
                f"{where} gives no density: {DEFAULT_DENSITY:g} kg/m3 (casting silicone) is used",
                stacklevel=3,
            )

    if model == "linear":
        modulus = read_quantity(
            table.get("youngs_modulus"), "Pa", f"{where}: youngs_modulus", noun="modulus"
        )
        return SolidMaterial(NeoHooke.from_youngs_modulus(modulus, poisson), density, poisson, name)
    coefficients: dict[str, list[float]] = {}
    for word in words & set(table):
        values = table[word] if isinstance(table[word], list) else [table[word]]
        key = f"{where}: {word}"
        if word == "alpha":
            coefficients[word] = [_number(v, key) for v in values]
        else:
            coefficients[word] = [read_quantity(v, "Pa", key, noun="modulus") for v in values]
    return SolidMaterial(make_law(model, coefficients, where), density, poisson, name)


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"must be a number, got {value!r}", where)
    return float(value)
