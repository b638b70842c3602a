"""What a designer writes has an effect, or is refused; stored records may hold it."""

import tomllib
from pathlib import Path
from typing import get_args

import pytest

from data_schemas import FingerDesign, Preset, RecordError
from data_schemas.storage import read_toml
from finray_calib.cli._export import PRESETS as MESHES
from sim import PRESETS, design_toml, preset_design


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[indenter]\nshape = "ball"\nedge_radius_mm = 1.0', r"indenter\.edge_radius_mm has no effect, .* cuboid"),
        ("[skeleton]\nrib_count = 0\nrib_thickness_mm = 1.2", r"rib_thickness_mm has no effect, .* rib_count = 1 or"),
        ("[skeleton]\nrib_count = 0\nrib_angle_deg = 5.0", r"rib_angle_deg has no effect"),
        (
            "[pad]\nwidth_mm = 30.0\n[mechanics.film]\nyoungs_modulus_mpa = 4000.0\npoisson_ratio = 0.3",
            r"mechanics\.film has no effect, because the pad has no film; add the table \[pad\.film\]",
        ),
        (
            '[camera]\ncalibration = "lens.yaml"\nfield_of_view_deg = 90.0',
            r"camera\.field_of_view_deg has no effect, because camera\.calibration already states",
        ),
    ],
)
def test_a_field_without_effect_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "finger.toml"
    path.write_text(text)
    with pytest.raises(RecordError, match=message):
        read_toml(path, FingerDesign)
    # a record of it, whose fields are all written out, can be read
    assert FingerDesign.model_validate(tomllib.loads(text)).unused_fields()


@pytest.mark.parametrize("name", PRESETS)
def test_the_file_of_a_preset_holds_only_what_has_an_effect(tmp_path: Path, name: str) -> None:
    path = tmp_path / "finger.toml"
    path.write_text(design_toml(preset_design(name)))
    assert read_toml(path, FingerDesign) == preset_design(name)


def test_every_part_of_a_design_refuses_unknown_keys(tmp_path: Path) -> None:
    path = tmp_path / "finger.toml"
    parts = ["pad.film", "skeleton.backing", *(f"mechanics.{m}" for m in ("skeleton", "gel", "onyx", "mirror", "film"))]
    parts += ["pad", "coating", "light", "second_light", "enclosure", "mirror", "camera", "indenter", "skeleton"]
    for part in (*parts, "mechanics", "mesh", "unheard_of"):
        path.write_text(f"[{part}]\nunheard_of = 1\n")
        with pytest.raises(RecordError, match=r"unheard_of': unknown key"):
            read_toml(path, FingerDesign)


def test_meshes_have_one_set_of_names() -> None:
    assert get_args(Preset) == MESHES
