"""Rig and plan files to start from: ready-made ones, and the commented TOML that a person edits.

Ready-made are the paper's eight filters over a simulated bench with plans for them, and the paper's real set-up with
what was found in the place of what is assumed. What is written is read again by ``read_toml``.
"""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

from data_schemas import (
    EXCHANGED_FILTERS,
    PRACTICE_FAULTS,
    BandPassFilter,
    CameraPlan,
    CameraSettings,
    FilterWheelSettings,
    HiddenPaint,
    LampSettings,
    LaserSettings,
    OutsideLayer,
    PaintPlan,
    RegionOfInterest,
    RigFile,
    SimulatedBench,
    TactileRig,
)
from data_schemas.storage import toml_text, write_bytes
from rigs._drivers import FoundDevice, Kind, offered
from rigs.light_guard import TEST_VALID_DAYS

PAPER_FILTERS_NM = (405, 450, 500, 532, 560, 600, 630, 660)
# The simulated filters come with a certificate: centre and width within 0.2 nm, uniform, is 0.12 nm, rounded up.
CERTIFIED_NM = 0.15
CAMERA_FILTER = "532"
REGION_OF_HEIGHT = 220 / 1024
RED_PAINT = HiddenPaint(
    name="red",
    mode_nm=597.0,
    fwhm_nm=48.0,
    asinh_skewness=1.8,
    energy_yield=0.25,
    absorption_peak_nm=560.0,
)
GREEN_PAINT = HiddenPaint(
    name="green",
    mode_nm=516.0,
    fwhm_nm=38.0,
    asinh_skewness=0.9,
    energy_yield=0.30,
    absorption_peak_nm=470.0,
    reflectance_long_wavelength=0.25,
)
DEFAULT_PAINTS = {"red": RED_PAINT, "green": GREEN_PAINT}


def simulated_rig(
    paint: str,
    camera_response: str | None = None,
    seed: int = 1,
    width_px: int = 1280,
    height_px: int = 1024,
) -> RigFile:
    """Return the paper's rig over a simulated bench.

    Parameters
    ----------
    paint
        "red" or "green" (a default hidden paint), or the CSV file of a measured re-radiation matrix.
    camera_response
        CSV file of the camera's response; the assumed response if left out.
    seed
        Seed of everything on the bench that is left to chance.
    width_px, height_px
        Size of the sensor (pixels).
    """
    hidden = DEFAULT_PAINTS.get(paint)
    return RigFile(
        name=f"simulated rig, {paint if hidden else Path(paint).stem}",
        camera=CameraSettings(width_px=width_px, height_px=height_px, response=camera_response or "assumed"),
        filter_wheel=FilterWheelSettings(
            filters=tuple(
                BandPassFilter(
                    slot=slot,
                    name=str(center_nm),
                    center_nm=center_nm,
                    center_uncertainty_nm=CERTIFIED_NM,
                    fwhm_uncertainty_nm=CERTIFIED_NM,
                )
                for slot, center_nm in enumerate(PAPER_FILTERS_NM, 1)
            )
        ),
        simulated=SimulatedBench(seed=seed, paint=hidden, material=None if hidden else paint),
    )


def paint_plan(paint_name: str, camera: CameraSettings | None = None) -> PaintPlan:
    """Return a plan whose region is the middle of the sample: 220 x 220 px of a frame 1024 px high."""
    return PaintPlan(paint_name=paint_name, region=_middle(camera or CameraSettings()))


def camera_plan(
    camera_name: str, camera: CameraSettings | None = None, filter_name: str | None = CAMERA_FILTER
) -> CameraPlan:
    """Return a plan whose region is the middle of the white tile, lit through one filter (None: without the wheel).

    The filter at 532 nm lets the lamp saturate green first, and red and blue within the longest exposure.
    """
    return CameraPlan(camera_name=camera_name, filter_name=filter_name, region=_middle(camera or CameraSettings()))


def _middle(camera: CameraSettings) -> RegionOfInterest:
    """Return the middle of the frame: 220 x 220 px of one 1024 px high."""
    side_px = 2 * round(0.5 * REGION_OF_HEIGHT * camera.height_px)
    return RegionOfInterest(
        row_px=(camera.height_px - side_px) // 4 * 2,
        column_px=(camera.width_px - side_px) // 4 * 2,
        height_px=side_px,
        width_px=side_px,
    )


def tactile_rig(*, simulated: bool) -> TactileRig:
    """Return a rig whose stage presses a finger by itself: one to practise on, or a usual one to fill in.

    Parameters
    ----------
    simulated
        Whether camera, stage, load cell and finger are simulated.
    """
    addresses = ("", "", "") if simulated else ("0", "/dev/ttyUSB0", "/dev/ttyACM0")
    drivers = ("simulated",) * 3 if simulated else ("picamera2", "grbl", "hx711")
    camera, stage, cell = ({"driver": d, "address": a} for d, a in zip(drivers, addresses, strict=True))
    size = {"width_px": 320, "height_px": 240} if simulated else {"width_px": 1638, "height_px": 1230}
    model = "simulated finger" if simulated else "imx219"
    travel = {"press_travel_mm": (-9.0, 0.0), "pad_travel_mm": (0.0, 80.0), "base_mm": 0.0, "clear_mm": 0.0}
    return TactileRig.model_validate(
        {
            "name": "simulated finger" if simulated else "finger bench",
            "camera": {**camera, **size, "model": model, "longest_exposure_s": 4.2},
            "stage": {**stage, **travel, "homing": "switches", "model": ""},
            "load_cell": {**cell, "capacity_n": 9.8, "force_limit_n": 5.0},
            "simulated": {} if simulated else None,
        }
    )


def write_tactile_rig(rig: TactileRig, path: Path) -> Path:
    """Write a tactile rig as a new commented file and return its path."""
    parts: list[tuple[str, Any, Mapping[str, str]]] = [("camera", rig.camera, _CAMERA)]
    parts += [
        (name, part, {key: field.description or "" for key, field in type(part).model_fields.items()})
        for name, part in (("stage", rig.stage), ("load_cell", rig.load_cell), ("simulated", rig.simulated))
        if part is not None
    ]
    kinds: dict[str, Kind] = {"camera": "camera", "stage": "stage", "load_cell": "load cell"}
    text = f"""# A rig that presses a finger. Every value has its unit in its name; positions are machine coordinates.
name = {toml_text(rig.name)}
schema_version = {rig.schema_version}  # of rig files, so that later versions of finray can read this one
"""
    for name, part, comments in parts:
        drivers = {"driver": _driver_names(kinds[name])} if name in kinds else {}
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in part.model_dump().items()}
        text += f"\n[{name}]\n{_fields(values, {**comments, **drivers})}"
    return _write(path, text)


Role = Literal["camera", "filter wheel", "laser", "lamp"]
CAMERA_SERIAL: Final = "SERIAL-NUMBER"
"""Where nothing was found: no camera has this, so that the file is refused until it is filled in."""
WHEEL_PORT: Final = "/dev/ttyUSB0"
LASER_PORT: Final = "/dev/ttyACM0"
_PAPER: Final[dict[Role, dict[str, Any]]] = {
    "camera": {"driver": "aravis", "address": CAMERA_SERIAL, "model": "CM3-U3-13Y3C-CS"},
    "filter wheel": {"driver": "thorlabs", "address": WHEEL_PORT, "model": "FW212C"},
    "laser": {"driver": "arduino", "address": LASER_PORT},
    "lamp": {"driver": "manual"},
}
_TO_FILL_IN: Final[dict[Role, str]] = {
    "camera": f"camera: address = {CAMERA_SERIAL} stands for its serial number ('finray rig detect' lists cameras)",
    "filter wheel": f"filter_wheel: address = {WHEEL_PORT} is the usual port; 'finray rig detect' names the right one",
    "laser": f"laser: address = {LASER_PORT} is the usual port; 'finray rig detect' names the right one",
    "lamp": "lamp: driver = manual means that the operator switches it; if a controller does, give its driver and "
    "address",
}
_ALWAYS: Final = (
    "laser: compare wavelength_nm, power_mw and laser_class with the laser's label; a laser is not switched on unless "
    "the file states them",
    "filter_wheel.filters: correct the slots, and if you have certificates the centres and their uncertainties",
    "camera: width, height, bit_depth and the three noise figures are those of the camera of the GelSight Fin Ray "
    "paper",
)


def paper_rig(found: Mapping[Role, FoundDevice]) -> RigFile:
    """Return the paper's rig: eight filters known from a catalogue, a laser of 4.5 mW at 450 nm, a halogen lamp.

    Parameters
    ----------
    found
        Devices to use in the place of the assumed ones.
    """
    named = {role: _named(role, found.get(role)) for role in _PAPER}
    filters = tuple(
        BandPassFilter(slot=slot, name=str(center_nm), center_nm=center_nm)
        for slot, center_nm in enumerate(PAPER_FILTERS_NM, 1)
    )
    label = {"wavelength_nm": 450.0, "power_mw": 4.5, "laser_class": "3R"}
    return RigFile(
        name="paint bench",
        camera=CameraSettings.model_validate(named["camera"]),
        filter_wheel=FilterWheelSettings.model_validate({**named["filter wheel"], "filters": filters}),
        laser=LaserSettings.model_validate({**named["laser"], **label}),
        lamp=LampSettings.model_validate(named["lamp"]),
    )


def to_fill_in(found: Mapping[Role, FoundDevice]) -> tuple[str, ...]:
    """Return what the user has to fill in or compare in the file of :func:`paper_rig`."""
    return (*(text for role, text in _TO_FILL_IN.items() if role not in found), *_ALWAYS)


def _named(role: Role, device: FoundDevice | None) -> dict[str, Any]:
    """Return driver, address and model of a role."""
    if device is None:
        return _PAPER[role]
    model = {"model": device.what} if "model" in _PAPER[role] else {}
    return {"driver": device.driver, "address": device.address, **model}


_ABOVE: Final = ("address", "response")
_CAMERA: Final = {
    "address": "aravis: name, serial number or IP address; gentl: PRODUCER.cti#SERIAL; mjpeg: http://host:port/path;\n"
    "picamera2: number; indi: host:port/device; micro-manager: FILE.cfg; folder: folder; simulated: none",
    "model": "as on its label",
    "width_px": "width of a raw frame, pixels",
    "height_px": "height of a raw frame, pixels",
    "bit_depth": "bits of a raw count: 8, 10, 12, 14 or 16",
    "bayer_pattern": "colours of the 2 x 2 pixels at the top left",
    "black_level_dn": "count in the dark, DN; better from a camera session",
    "gain_e_per_dn": "electrons per count, e/DN; better from a camera session",
    "gain_db": "amplification that is set and read back, dB; lowest is best",
    "read_noise_e": "standard deviation in the dark, electrons; better from a camera session",
    "shortest_exposure_s": "seconds",
    "longest_exposure_s": "seconds",
    "response": '"assumed" (smooth stand-in curves) or a CSV file with the header\n'
    "wavelength_nm,red_percent,green_percent,blue_percent; light beyond 780 nm is not counted: cut infrared off",
}
_WHEEL: Final = {
    "address": "thorlabs: serial port; indi: host:port/device; alpaca: http://host:port/number; others: none",
    "model": "as on its label",
}
_FILTER: Final = {
    "slot": "as on the wheel, from 1",
    "name": "name that plans use",
    "center_nm": "centre wavelength, nm",
    "center_uncertainty_nm": "its standard uncertainty, nm",
    "fwhm_nm": "full width at half maximum, nm",
    "fwhm_uncertainty_nm": "its standard uncertainty, nm",
    "shape_order": "1 Gaussian to 2 flat top",
    "peak_transmission": "0 to 1; used for metering only",
    "blocking_od": "optical density outside the pass band",
    "blocking_uncertainty_od": "its standard uncertainty",
}
_LIGHT_ADDRESS: Final = (
    "arduino: serial port; indi: host:port/device; alpaca: http://host:port/switch/DEVICE/NUMBER or\n"
    "http://host:port/covercalibrator/NUMBER; "
)
_LASER: Final = {
    "address": f"{_LIGHT_ADDRESS}simulated: none",
    "wavelength_nm": "wavelength on its label, nm",
    "fwhm_nm": "full width at half maximum of the line, nm",
    "power_mw": "power on its label, mW",
    "laser_class": "class on its label (IEC 60825-1): 1, 1M, 2, 2M, 3R, 3B or 4",
}
_OUTSIDE_LAYER: Final = {
    "kind": "interlock, relay with pulse, or dead-man (of the light's own controller)",
    "tested_on": "day of the last test",
    "test": "what was done and seen",
}
_LAMP: Final = {
    "address": f"{_LIGHT_ADDRESS}manual and simulated: none",
    "spectrum": "planck-2856K: rated tungsten halogen; or a CSV file (wavelength_nm,power_rel)",
    "temperature_uncertainty_k": "standard uncertainty in kelvin: 50 from the label alone, 10 to 20 measured",
}
_WHITE: Final = {
    "reflectance": "of the white tile, 0 to 1, from its certificate",
    "uncertainty_rel": "its standard uncertainty, relative",
}
_BANDS: Final = {
    "calibration_rel": "error of a filter's value, common to red, green and blue",
    "response_rel": "error of a channel's response in a filter's band",
    "stray_light_rel": "light past the filters: error of a value, relative to the largest outside the laser's filter",
}


def write_rig(rig: RigFile, path: Path) -> Path:
    """Write a rig as a new file and return its path."""
    return _write(path, rig_toml(rig))


def write_plan(plan: PaintPlan | CameraPlan, path: Path) -> Path:
    """Write a plan as a new file and return its path."""
    return _write(path, plan_toml(plan))


def _write(path: Path, text: str) -> Path:
    """Write a new text file."""
    write_bytes(path, text.encode())
    return path


def rig_toml(rig: RigFile) -> str:
    """Return a rig as commented TOML."""
    wheel = rig.filter_wheel
    first, *others = wheel.filters
    of_lasers = f"{_driver_names('light', 'manual')}; arduino has a dead-man switch"
    of_lamps = f"{_driver_names('light')}; manual: the operator switches it"
    filters = [_filter_toml(first, _FILTER), *(_filter_toml(band, {}) for band in others)]
    return f"""# A calibration rig. Every value has its unit in its name: _nm, _s, _mw, _dn (counts), _e (electrons).
name = {toml_text(rig.name)}
schema_version = {rig.schema_version}  # of rig files, so that later versions of finray can read this one

[camera]
{_fields(rig.camera.model_dump(), _CAMERA | {"driver": _driver_names("camera")})}
[filter_wheel]
{_fields(wheel.model_dump(exclude={"filters"}), _WHEEL | {"driver": _driver_names("filter wheel")})}
# One table for each filter; slots count from 1. The uncertainties are standard uncertainties of a certificate; leave
# them out for a filter known from a catalogue only. shape_order 1 is a Gaussian pass band, 2 the flat top of a
# hard-coated filter. curve = "FILE.csv" (wavelength_nm,transmission, 0 to 1) names a measured transmission: it takes
# the place of width, shape and peak, and center_nm must lie within 5 nm of its centre.
{"".join(filters)}[laser]
# Class and power are stated so that nobody switches it on unknowingly.
{_fields(rig.laser.model_dump(exclude={"outside_layer"}), _LASER | {"driver": of_lasers})}\
{_outside_layer_toml(rig.laser.outside_layer)}
[lamp]
{_fields(rig.lamp.model_dump(), _LAMP | {"driver": of_lamps})}
[white_reference]
{_fields(rig.white_reference.model_dump(), _WHITE)}
[band_uncertainty]
# Relative standard uncertainties that the frames cannot show; lower a value only if you have measured it.
{_fields(rig.band_uncertainty.model_dump(), _BANDS)}{"" if rig.simulated is None else _bench_toml(rig.simulated)}"""


def _driver_names(kind: Kind, but: str = "") -> str:
    """Return what can be named as driver, in a comment."""
    return ", ".join(sorted(name for name in offered(kind) if name != but))


def _fields(values: Mapping[str, object], comments: Mapping[str, str]) -> str:
    """Return a table's lines with their comments, beside them or, where these are long, above."""
    lines = {name: _field(name, value) for name, value in values.items()}
    width = max(len(line) for name, line in lines.items() if name not in _ABOVE)
    return "".join(_commented(name, line, comments.get(name, ""), width) for name, line in lines.items())


def _field(name: str, value: object) -> str:
    """Return one line; what is left out stands in a comment."""
    if value is None or (name == "address" and value == ""):
        return f"# {name} = ..."
    return f"{name} = {toml_text(value) if isinstance(value, str) else repr(value)}"


def _commented(name: str, line: str, comment: str, width: int) -> str:
    """Return a line with its comment."""
    if comment and name in _ABOVE:
        return "".join(f"# {part}\n" for part in comment.split("\n")) + f"{line}\n"
    return f"{line:{width}}  # {comment}\n" if comment else f"{line}\n"


def _filter_toml(band: BandPassFilter, comments: Mapping[str, str]) -> str:
    """Return one filter's table; a measured curve stands in it only where there is one."""
    left_out = {"curve"} if band.curve is None else set()
    return f"[[filter_wheel.filters]]\n{_fields(band.model_dump(exclude=left_out), comments)}\n"


def _outside_layer_toml(layer: OutsideLayer | None) -> str:
    """Return the table of what switches the laser off outside the computer; a comment where none is declared."""
    head = f"""\
# [laser.outside_layer] declares hardware that switches the laser off when the computer cannot, and the day when it was
# last tested with the laser on; the test is valid for {TEST_VALID_DAYS} days. A laser of class 3R or above is lit only
# with such a layer. The firmware for driver arduino is such a layer, and every session tests it.
"""
    if layer is None:
        example = '{ kind = "interlock", tested_on = 2026-01-31, test = "lid opened: dark at once" }'
        return f"{head}# outside_layer = {example}\n"
    return f"{head}[laser.outside_layer]\n{_fields(layer.model_dump(), _OUTSIDE_LAYER)}"


def _bench_toml(bench: SimulatedBench) -> str:
    """Return what lies on the simulated bench."""
    head = f"""
# What lies on the simulated bench; real drivers ignore it. Give either a [simulated.paint] table or
# material = "FILE.csv" (a measured re-radiation matrix).
[simulated]
seed = {bench.seed}
{_fault_toml(bench)}"""
    if bench.material is not None:
        return f"{head}material = {toml_text(bench.material)}\n"
    fields = {} if bench.paint is None else bench.paint.model_dump()
    lines = "".join(f"{k} = {toml_text(v) if isinstance(v, str) else repr(v)}\n" for k, v in fields.items())
    return f"{head}\n[simulated.paint]\n{lines}"


def _fault_toml(bench: SimulatedBench) -> str:
    """Return the line of a fault to practise on; a comment where there is none."""
    if bench.practice_fault is not None:
        return f"practice_fault = {toml_text(bench.practice_fault)}\n"
    named = ", ".join((*PRACTICE_FAULTS, EXCHANGED_FILTERS))
    comment = textwrap.fill(f"a fault to practise on: {named}", 118, initial_indent="# ", subsequent_indent="# ")
    return f'{comment}\n# practice_fault = "stray light"\n'


def plan_toml(plan: PaintPlan | CameraPlan) -> str:
    """Return a plan as commented TOML."""
    return (_paint_plan_toml(plan) if isinstance(plan, PaintPlan) else _camera_plan_toml(plan)) + _region_toml(
        plan.region
    )


def _paint_plan_toml(plan: PaintPlan) -> str:
    """Return a paint plan without its region."""
    filters = "# filters = [...]: names in the order of capture; leave it out for all filters of the rig"
    if plan.filters is not None:
        filters = f"filters = [{_names(plan.filters)}]"
    tilt = """# second_tilt_deg = 30.0 and second_tilt_filters = [two names] test whether the paint is diffuse"""
    if plan.second_tilt_deg is not None and plan.second_tilt_filters is not None:
        tilt = f"""second_tilt_deg = {plan.second_tilt_deg!r}
second_tilt_filters = [{_names(plan.second_tilt_filters)}]"""
    return f"""# A paint session: white tile, sample beside a ColorChecker, sample; tile and sample through filters.
schema_version = {plan.schema_version}
kind = "{plan.kind}"
paint_name = {toml_text(plan.paint_name)}
{filters}
# the filter that passes the laser line
excitation_filter = {toml_text(plan.excitation_filter)}
# brightest pixel of the region, as a fraction of full scale
target_fraction = {plan.target_fraction!r}
# exposures of each step, as multiples of the metered exposure
bracket = [{", ".join(repr(factor) for factor in plan.bracket)}]
darks_per_exposure = {plan.darks_per_exposure}
# second angle between the laser beam and the sample's normal, and the two filters used at it
{tilt}

# The area that is evaluated (paint, or white tile), in pixels of the raw frame.
"""


def _camera_plan_toml(plan: CameraPlan) -> str:
    """Return a camera plan without its region."""
    through = "# filter_name = ...: without it, the wheel must be out of the beam"
    if plan.filter_name is not None:
        through = f"filter_name = {toml_text(plan.filter_name)}"
    return f"""# A camera session: flat frames of the white tile from dark to beyond saturation, and dark frames.
schema_version = {plan.schema_version}
kind = "{plan.kind}"
camera_name = {toml_text(plan.camera_name)}
# the filter in the beam
{through}
# number of exposures up to the saturation of each channel, evenly spaced, and number of frames at each
levels = {plan.levels}
frames_per_level = {plan.frames_per_level}
# further flat frames at half saturation and as many dark ones, for PRNU and DSNU
repeats = {plan.repeats}
longest_exposure_s = {plan.longest_exposure_s!r}

# An evenly lit part of the white tile in pixels of the raw frame.
"""


def _region_toml(region: RegionOfInterest) -> str:
    """Return the region's table."""
    return f"""[region]
row_px = {region.row_px}
column_px = {region.column_px}
height_px = {region.height_px}
width_px = {region.width_px}
"""


def _names(names: tuple[str, ...]) -> str:
    """Return the entries of a TOML array of strings."""
    return ", ".join(toml_text(name) for name in names)
