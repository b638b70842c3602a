"""The design of a classic sensor: what it refuses, what has no effect, and the file that is written of it."""

import pytest

from data_schemas import (
    CameraBelow,
    CoatSurface,
    ColouredLight,
    FieldError,
    FingerDesign,
    LightPanel,
    PlainSensor,
    RecordError,
    SensorCoat,
    SimulateError,
    TranslucentLayer,
)
from data_schemas._design_parts import Mirror, TactileCamera
from sim import SENSORS, is_sensor, preset_sensor, read_design, read_sensor, sensor_inputs, sensor_toml


@pytest.mark.parametrize("name", SENSORS)
def test_a_written_sensor_is_read_as_it_was(tmp_path, name):
    path = tmp_path / "sensor.toml"
    path.write_text(sensor_toml(preset_sensor(name)))
    assert is_sensor(path)
    assert read_sensor(path) == preset_sensor(name)


def test_every_field_is_written_or_named(tmp_path):
    given = PlainSensor(
        coating=SensorCoat(diffuse_share=0.5, translucent=TranslucentLayer()),
        camera=CameraBelow(calibration="lens.yaml", response="eye.csv", roll_deg=3.0),
        lights=(ColouredLight(channel="red", peak_wavelength_nm=640.0, fwhm_nm=18.0),),
        surface=CoatSurface(file="coat.png", step_mm=0.1, unit_mm=0.01, holds="height"),
        origin={"lights.width_mm": "measured", "box_reflectance": "data sheet"},
        uncertainty_rel={"pad.thickness_mm": 0.1},
    )
    path = tmp_path / "sensor.toml"
    text = sensor_toml(given)
    path.write_text(text)
    assert read_sensor(path) == given.model_copy(update={"indenter": PlainSensor().indenter})
    for field in CoatSurface.model_fields:
        assert f"{field} = " in text
    assert sensor_inputs(given, path) == [path, *(tmp_path / name for name in ("lens.yaml", "eye.csv", "coat.png"))]


def test_a_preset_is_changed_and_loses_the_origin_of_what_is_changed(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text('preset = "digit"\nname = "mine"\n[pad]\nlength_mm = 31.0\n[camera]\nwidth_px = 24\n')
    assert is_sensor(path)
    sensor, ready = read_sensor(path), preset_sensor("digit")
    assert (sensor.pad.length_mm, sensor.pad.width_mm, sensor.camera.width_px) == (31.0, 20.0, 24)
    assert sensor.lights == ready.lights
    assert set(ready.origin) - set(sensor.origin) == {"pad.length_mm"}
    path.write_text(path.read_text() + '[[lights]]\nchannel = "red"\n')
    sensor = read_sensor(path)
    assert len(sensor.lights) == 1
    assert not [field for field in sensor.origin if field.startswith("lights")]


def opened(path):
    """Read a design as the command line does."""
    return read_sensor(path) if is_sensor(path) else None


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ('kind = "glove"\n', RecordError, r"kind must be 'finger' or 'sensor', got 'glove'"),
        ('kind = "sensor"\npreset = 3\n', RecordError, "must be the name of a ready-made sensor"),
        ('kind = "sensor"\npreset = "flat-70x35"\n', RecordError, '; leave out kind'),
        ('kind = "sensor"\npreset = "nose"\n', SimulateError, "no preset sensor 'nose'; valid names are gelsight-flat"),
        ('kind = "sensor"\nlight = 3\n', RecordError, r"'light': unknown key; did you mean 'lights'"),
        ('kind = "sensor"\nlights = []\n', RecordError, "at least 1"),
        ('kind = "sensor"\nwall_reflectance = 1.5\n', RecordError, "must be at most 1"),
        (
            'kind = "sensor"\n[pad]\nthickness_mm = 0.004\n[coating.translucent]\n', RecordError,
            "must be at most pad.thickness_mm = .* is part of the gel",
        ),
        ('kind = "sensor"\nwalls = "clear"\nwall_reflectance = 0.1\n', RecordError, 'because walls = "clear"'),
        (
            'kind = "sensor"\n[surface]\nfile = "a.npy"\nstep_mm = 0.1\n[indenter]\nposition_mm = 5.0\n',
            RecordError, r"indenter has no effect, because \[surface\] and \[indenter\] both state the pressed shape",
        ),
        (
            'kind = "sensor"\n[coating]\ndiffuse_reflectance = 0.5\ndiffuse_reflectance_rgb = [0.1, 0.2, 0.3]\n',
            RecordError, r"diffuse_reflectance has no effect, because coating\.diffuse_reflectance_rgb already states",
        ),
        (
            'kind = "sensor"\n[coating]\ndiffuse_reflectance_rgb = [0.1, 0.2, 0.3]\n[coating.translucent]\n',
            RecordError, r"diffuse_reflectance_rgb has no effect, because coating\.translucent already has its own",
        ),
        (
            'kind = "sensor"\n[coating]\ndiffuse_share = 1.0\nroughness_alpha = 0.2\n',
            RecordError, "roughness_alpha has no effect, because a coat of diffuse_share = 1 contains no",
        ),
        (
            'kind = "sensor"\n[camera]\ncalibration = "lens.yaml"\nfield_of_view_deg = 40.0\n',
            RecordError, r"field_of_view_deg has no effect, because camera\.calibration already states",
        ),
        (
            'kind = "sensor"\n[surface]\nfile = "a.stl"\nstep_mm = 0.1\n', RecordError,
            r"surface\.step_mm has no effect, because it belongs to a height map",
        ),
        (
            'kind = "sensor"\n[origin]\n"lights.wdith_mm" = "measured"\n', RecordError,
            r"'lights\.wdith_mm' is not a field of the design; did you mean lights\.width_mm",
        ),
        ('kind = "sensor"\n[camera]\ntilt_deg = 100.0\n', RecordError, r"tilt_deg' \(in deg\): must be at most 85"),
    ],
)  # fmt: skip
def test_refusals_of_files(tmp_path, text, error, message):
    path = tmp_path / "sensor.toml"
    path.write_text(text)
    with pytest.raises(error, match=message):
        opened(path)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CoatSurface(file="coat.tif"), r"must end in \.npy or \.png .* or in \.stl"),
        (lambda: CoatSurface(file="coat.npy"), "step_mm is missing; a height map needs"),
        (lambda: CoatSurface(file="coat.png", step_mm=0.1), "unit_mm is missing; a picture needs"),
        (lambda: ColouredLight(channel="white", fwhm_nm=20.0), "fwhm_nm is not supported for a white LED"),
        (lambda: ColouredLight(channel="red", depth_mm=1.0), r"it must be more than 1\.53 mm"),
        (lambda: TactileCamera(position_mm=(0.0, 1.0, 2.0)), r"y must be negative \(outside the gel"),
        (lambda: Mirror(base_yz_mm=(1.0, 0.0)), r"base_yz_mm: y must be negative \(behind the inner face"),
        (lambda: Mirror(base_yz_mm=(-9.0, 5.0), tip_yz_mm=(-4.0, 5.0)), r"tip_yz_mm: z = 5 mm must be greater than"),
        (
            lambda: FingerDesign(further_lights=(LightPanel(peak_wavelength_nm=470.0),)),
            r"further_lights \(entry 1\)\.peak_wavelength_nm must equal light\.peak_wavelength_nm",
        ),
    ],
)  # fmt: skip
def test_refusals_of_values(make, message):
    with pytest.raises(FieldError, match=message):
        make()


def test_a_finger_may_say_that_it_is_one(tmp_path):
    path = tmp_path / "finger.toml"
    path.write_text('kind = "finger"\npreset = "flat-70x35"\n')
    assert not is_sensor(path)
    assert read_design(path).name == "flat-70x35"


def test_what_is_no_design_file_is_no_sensor(tmp_path):
    assert not is_sensor(tmp_path / "nothing.toml")
    (tmp_path / "press.surfaces.json").write_text("{}")
    assert not is_sensor(tmp_path / "press.surfaces.json")
