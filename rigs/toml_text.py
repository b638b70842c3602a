"""Rig and plan files as commented TOML, ready to be edited by a person and read by ``read_toml``."""

import json
from pathlib import Path

from data_schemas.camera import CameraPlan
from data_schemas.capture import PaintPlan, RegionOfInterest
from data_schemas.rig import BandPassFilter, RigFile, SimulatedBench
from data_schemas.storage import write_bytes


def write_rig(rig: RigFile, path: Path) -> Path:
    """Write a rig on the simulated bench as a new file and return its path."""
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
    camera, laser = rig.camera, rig.laser
    return f"""# A calibration rig. Every value has its unit in its name: _nm, _s, _mw, _dn (counts), _e (electrons).
name = {_quoted(rig.name)}

[camera]
driver = "{camera.driver}"
model = {_quoted(camera.model)}
width_px = {camera.width_px}
height_px = {camera.height_px}
bit_depth = {camera.bit_depth}
bayer_pattern = "{camera.bayer_pattern}"
black_level_dn = {camera.black_level_dn!r}
gain_e_per_dn = {camera.gain_e_per_dn!r}
read_noise_e = {camera.read_noise_e!r}
shortest_exposure_s = {camera.shortest_exposure_s!r}
longest_exposure_s = {camera.longest_exposure_s!r}
# "assumed" (smooth stand-in curves) or a CSV file with the header
# wavelength_nm,red_percent,green_percent,blue_percent
response = {_quoted(camera.response)}

[filter_wheel]
driver = "{rig.filter_wheel.driver}"
model = {_quoted(rig.filter_wheel.model)}

# One table for each filter; slots count from 1. The uncertainties are standard uncertainties of a certificate; leave
# them out for a filter known from a catalogue only. shape_order 1 is a Gaussian pass band, 2 the flat top of a
# hard-coated filter. curve = "FILE.csv" (wavelength_nm,transmission, 0 to 1) names a measured transmission: it takes
# the place of width, shape and peak, and center_nm must lie within 5 nm of its centre.
{"".join(_filter_toml(f) for f in rig.filter_wheel.filters)}
[laser]
driver = "{laser.driver}"
wavelength_nm = {laser.wavelength_nm!r}
fwhm_nm = {laser.fwhm_nm!r}
power_mw = {laser.power_mw!r}
# Class and power are named so that nobody switches it on unknowingly.
laser_class = "{laser.laser_class}"

[lamp]
driver = "{rig.lamp.driver}"
spectrum = "{rig.lamp.spectrum}"

[white_reference]
# Reflectance of the white tile (0 to 1) and its relative standard uncertainty.
reflectance = {rig.white_reference.reflectance!r}
uncertainty_rel = {rig.white_reference.uncertainty_rel!r}
{"" if rig.simulated is None else _bench_toml(rig.simulated)}"""


def _quoted(text: str) -> str:
    """Return a TOML basic string."""
    return json.dumps(text, ensure_ascii=False)


def _filter_toml(band: BandPassFilter) -> str:
    """Return one filter's table."""
    curve = "" if band.curve is None else f"curve = {_quoted(band.curve)}\n"
    return f"""[[filter_wheel.filters]]
slot = {band.slot}
name = {_quoted(band.name)}
{curve}center_nm = {band.center_nm!r}
center_uncertainty_nm = {band.center_uncertainty_nm!r}
fwhm_nm = {band.fwhm_nm!r}
fwhm_uncertainty_nm = {band.fwhm_uncertainty_nm!r}
shape_order = {band.shape_order!r}
peak_transmission = {band.peak_transmission!r}
blocking_od = {band.blocking_od!r}
blocking_uncertainty_od = {band.blocking_uncertainty_od!r}

"""


def _bench_toml(bench: SimulatedBench) -> str:
    """Return what lies on the simulated bench."""
    head = f"""
# What lies on the simulated bench; real drivers ignore it. Give either a [simulated.paint] table or
# material = "FILE.csv" (a measured re-radiation matrix).
[simulated]
seed = {bench.seed}
"""
    if bench.material is not None:
        return f"{head}material = {_quoted(bench.material)}\n"
    fields = {} if bench.paint is None else bench.paint.model_dump()
    lines = "".join(f"{k} = {_quoted(v) if isinstance(v, str) else repr(v)}\n" for k, v in fields.items())
    return f"{head}\n[simulated.paint]\n{lines}"


def plan_toml(plan: PaintPlan | CameraPlan) -> str:
    """Return a plan as commented TOML."""
    return (_paint_plan_toml(plan) if isinstance(plan, PaintPlan) else _camera_plan_toml(plan)) + _region_toml(
        plan.region
    )


def _paint_plan_toml(plan: PaintPlan) -> str:
    """Return a paint plan without its region."""
    filters = "# filters = [...]: names in capture order; all of the rig if left out"
    if plan.filters is not None:
        filters = f"filters = [{_names(plan.filters)}]"
    tilt = """# second_tilt_deg = 30.0 and second_tilt_filters = [two names] test whether the paint is diffuse"""
    if plan.second_tilt_deg is not None and plan.second_tilt_filters is not None:
        tilt = f"""second_tilt_deg = {plan.second_tilt_deg!r}
second_tilt_filters = [{_names(plan.second_tilt_filters)}]"""
    return f"""# A paint session: white tile, sample beside a ColorChecker, sample; through all filters of the rig.
kind = "{plan.kind}"
paint_name = {_quoted(plan.paint_name)}
{filters}
# the filter that passes the laser line
excitation_filter = {_quoted(plan.excitation_filter)}
# brightest pixel of the region, as a fraction of full scale
target_fraction = {plan.target_fraction!r}
# exposures of each step relative to the metered one
bracket = [{", ".join(repr(factor) for factor in plan.bracket)}]
darks_per_exposure = {plan.darks_per_exposure}
# second angle between the laser beam and the sample's normal, and the two filters used at it
{tilt}

# The painted (and white) area in pixels of the raw frame.
"""


def _camera_plan_toml(plan: CameraPlan) -> str:
    """Return a camera plan without its region."""
    through = "# filter_name = ...: left out, the wheel must be out of the beam"
    if plan.filter_name is not None:
        through = f"filter_name = {_quoted(plan.filter_name)}"
    return f"""# A camera session: flat frames of the white tile from dark to beyond saturation, and dark frames.
kind = "{plan.kind}"
camera_name = {_quoted(plan.camera_name)}
# the filter in the beam
{through}
# exposures up to the saturation of each channel, evenly spaced, and frames of each
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
    return ", ".join(_quoted(name) for name in names)
