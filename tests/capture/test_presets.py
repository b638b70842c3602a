from pathlib import Path

import pytest

from data_schemas import CameraPlan, PaintPlan, RecordError, RigFile
from data_schemas.storage import read_toml
from rigs import camera_plan, paint_plan, simulated_rig, write_plan, write_rig
from rigs.capture import camera_step, paint_steps


@pytest.mark.parametrize("sample", ["red", "green", 'curves/"odd" name.csv'])
def test_rig_and_plan_survive_their_text(tmp_path: Path, sample: str) -> None:
    rig, plan = simulated_rig(sample, "cameras/imx219.csv", seed=5), paint_plan("red")
    assert read_toml(write_rig(rig, tmp_path / "rig.toml"), RigFile) == rig
    assert read_toml(write_plan(plan, tmp_path / "plan.toml"), PaintPlan) == plan
    chosen = plan.model_copy(update={"filters": ("450", "500")})
    assert read_toml(write_plan(chosen, tmp_path / "two.toml"), PaintPlan) == chosen
    tilted = plan.model_copy(update={"second_tilt_deg": 30.0, "second_tilt_filters": ("600", 'odd "630"')})
    assert read_toml(write_plan(tilted, tmp_path / "tilted.toml"), PaintPlan) == tilted
    with pytest.raises(RecordError, match="exists already and is not overwritten"):
        write_plan(plan, tmp_path / "plan.toml")


def test_measured_filter_survives_its_text(tmp_path: Path) -> None:
    rig = simulated_rig("red")
    bands = rig.filter_wheel.filters
    measured = bands[2].model_copy(update={"curve": 'curves/"500".csv'})
    wheel = rig.filter_wheel.model_copy(update={"filters": (*bands[:2], measured, *bands[3:])})
    rig = rig.model_copy(update={"filter_wheel": wheel})
    assert read_toml(write_rig(rig, tmp_path / "rig.toml"), RigFile) == rig


@pytest.mark.parametrize("filter_name", ["532", None])
def test_camera_plan_survives_its_text_and_fits_the_rig(tmp_path: Path, filter_name: str | None) -> None:
    plan = camera_plan("lab camera", filter_name=filter_name)
    assert (plan.region.height_px, plan.region.row_px) == (220, 402)
    assert read_toml(write_plan(plan, tmp_path / "camera.toml"), CameraPlan) == plan
    assert camera_step(plan, simulated_rig("red")).filter_name == filter_name


def test_preset_is_the_papers_rig_and_its_plan_fits() -> None:
    rig = simulated_rig("green", seed=7)
    assert [f.center_nm for f in rig.filter_wheel.filters] == [405, 450, 500, 532, 560, 600, 630, 660]
    assert rig.simulated is not None
    assert rig.simulated.seed == 7
    assert rig.simulated.paint is not None
    assert rig.simulated.paint.name == "green"
    plan = paint_plan("green")
    assert (plan.region.height_px, plan.region.width_px) == (220, 220)
    assert (plan.region.row_px, plan.region.column_px) == (402, 530)
    assert len(paint_steps(plan, rig)) == 26


def test_material_and_response_files_are_named_in_the_rig() -> None:
    rig = simulated_rig("curves/orange.csv", "cameras/imx219.csv")
    assert rig.simulated is not None
    assert rig.simulated.paint is None
    assert rig.simulated.material == "curves/orange.csv"
    assert rig.camera.response == "cameras/imx219.csv"
    assert rig.name == "simulated rig, orange"


def test_any_text_of_a_device_survives_the_file(tmp_path: Path) -> None:
    """A device may report control characters, of which TOML refuses one that JSON takes (DEL)."""
    rig = simulated_rig("red").model_copy(update={"name": 'wheel "A" \\ \u00fc\n\x01\x7f'})
    assert read_toml(write_rig(rig, tmp_path / "rig.toml"), RigFile).name == rig.name
