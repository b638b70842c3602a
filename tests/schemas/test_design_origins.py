"""The origins of a design follow its values: a number that is not the one of the paper is not shown as the paper's."""

from operator import attrgetter

import pytest

from data_schemas import FingerDesign
from data_schemas._design import PAPER_VALUES
from data_schemas.storage import read_toml
from sim import PRESETS, design_toml, preset_design


def test_the_default_finger_has_the_paper_s_numbers():
    design = FingerDesign()
    assert set(design.origin) == set(PAPER_VALUES)
    assert all(attrgetter(field)(design) in values for field, values in PAPER_VALUES.items())


@pytest.mark.parametrize("written", ["", '[origin]\n"pad.length_mm" = "paper"\n"pad.width_mm" = "paper"\n'])
def test_another_length_is_not_the_paper_s(tmp_path, written):
    """Neither where the file says nothing of it, nor where it kept the line that 'finray design init' wrote."""
    path = tmp_path / "finger.toml"
    path.write_text(f"[pad]\nlength_mm = 41.0\n[indenter]\nposition_mm = 20.0\n{written}")
    design = read_toml(path, FingerDesign)
    assert "pad.length_mm" not in design.origin
    assert design.origin["pad.width_mm"] == "paper"


def test_what_its_user_measured_stays_measured(tmp_path):
    path = tmp_path / "finger.toml"
    path.write_text('[pad]\nlength_mm = 41.0\n[indenter]\nposition_mm = 20.0\n[origin]\n"pad.length_mm" = "measured"\n')
    assert read_toml(path, FingerDesign).origin == {"pad.length_mm": "measured"}


@pytest.mark.parametrize("field", PAPER_VALUES)
def test_each_number_of_the_paper_is_compared(tmp_path, field):
    """A file that 'finray design init' wrote, with one number changed by hand."""
    *table, name = field.split(".")
    value = attrgetter(field)(FingerDesign())
    old = f"{name} = {list(value) if isinstance(value, tuple) else value}"
    changed = [1.01 * v for v in value] if isinstance(value, tuple) else 1.01 * value
    head, found, rest = design_toml(FingerDesign()).partition(f"[{'.'.join(table)}]")
    assert found
    assert old in rest
    path = tmp_path / "finger.toml"
    path.write_text(head + found + rest.replace(old, f"{name} = {changed}", 1))
    origin = read_toml(path, FingerDesign).origin
    assert field not in origin
    assert set(origin) == set(PAPER_VALUES) - {field}


@pytest.mark.parametrize("name", PRESETS)
def test_presets_keep_what_the_paper_gives(name):
    design = preset_design(name)
    assert all(design.origin[field] == "paper" for field in design.origin)
    assert ("pad.length_mm" in design.origin) == (name != "original-60x22")
