"""Named materials and material files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.materials.library import DEFAULT_DENSITY, library_entries, load_material
from flexapod.materials.ogden import Ogden


@pytest.mark.parametrize("entry", library_entries(), ids=lambda e: e.name)
def test_every_entry_loads_and_names_its_source(entry) -> None:  # type: ignore[no-untyped-def]
    material = load_material(entry.name)
    assert material.name == entry.name
    assert len(entry.source) > 20
    assert material.law.shear_modulus > 0.0


def test_dragon_skin_is_the_papers() -> None:
    material = load_material("dragon-skin-20-sospider")
    assert isinstance(material.law, Ogden)
    np.testing.assert_allclose(material.law.mu, (-0.6830e6, 0.8864e6, -0.1750e6), rtol=1e-12)
    assert material.law.alpha == (5.1017, 5.1673, 5.4285)
    assert material.density == 1080.0


def test_linear_materials_have_their_young_modulus_and_poisson() -> None:
    aluminium = load_material("aluminium")
    assert aluminium.law.shear_modulus == pytest.approx(70e9 / (2 * 1.32))
    # kappa = E / (3 (1 - 2 nu))
    assert aluminium.bulk_modulus == pytest.approx(70e9 / (3 * (1 - 0.64)))
    # G of the cited table, 1.287 GPa.
    assert load_material("pla").law.shear_modulus == pytest.approx(1.287e9, rel=1e-3)


def test_ogden_1972_meets_treloars_points() -> None:
    """The published coefficients, in the convention stated here, give the published data."""
    from importlib.resources import files

    from flexapod.materials.data import read_test
    from flexapod.materials.modes import nominal_stress

    law = load_material("vulcanised-rubber-ogden-1972").law
    for mode, least in (("uniaxial", 0.97), ("equibiaxial", 0.995), ("planar", 0.995)):
        path = files("flexapod.materials").joinpath(f"treloar_1944_{mode}.csv")
        d = read_test(str(path), mode)
        misfit = np.sum((nominal_stress(law, mode, d.stretch) - d.stress) ** 2)
        assert 1.0 - misfit / np.sum((d.stress - d.stress.mean()) ** 2) > least


def test_file_without_density_warns_and_density_can_be_given(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('model = "neo-hooke"\nmu = ["80 kPa"]\n', encoding="utf-8")
    with pytest.warns(UserWarning, match="gives no density"):
        assert load_material(path).density == DEFAULT_DENSITY
    material = load_material(path, density=1200.0, poisson=0.49)
    assert (material.density, material.poisson, material.name) == (1200.0, 0.49, "mine")
    assert material.law.shear_modulus == pytest.approx(80e3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mu = [", "is not a TOML file"),
        ('mu = ["1 kPa"]', "needs model"),
        ('model = "gent"', "model must be one of"),
        ('model = "neo-hooke"\nmu = [80]', "with its unit"),
        ('model = "neo-hooke"\nmu = ["80 mm"]', "does not measure"),
        ('model = "neo-hooke"\nmu = ["80 kPa"]\nnu = 0.5', "unknown key nu"),
        ('model = "ogden"\nmu = ["80 kPa"]\nalpha = ["2"]', "must be a number"),
        ('model = "neo-hooke"\nmu = ["80 kPa"]\ndensity = "1 g/cm^3"\npoisson = 0.5', "poisson"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        load_material(path, density=None if "density" in text else 1000.0)
    assert "bad" in str(caught.value)


def test_unknown_name_lists_the_names() -> None:
    with pytest.raises(InputError, match="dragon-skin-20-sospider"):
        load_material("dragonskin")
