"""One small laboratory for all tests of this folder: a captured session, its band signals, a paint, made-up records."""

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from data_schemas import provenance
from data_schemas.storage import write_record
from data_schemas.storage._array_files import end_child
from rigs import paint_plan, simulated_rig, write_plan, write_rig
from tests.command_line.records import capture_of, press, sweep, with_known_camera
from tests.command_line.running import succeed

PACKAGES_OF_EXTRAS = {
    "bench": ("numpyro",),
    "bluesky": ("bluesky", "ophyd_async"),
    "denoise": ("pyoidn",),
    "dng": ("rawpy",),
    "exr": ("OpenEXR",),
    "gentl": ("harvesters", "genicam"),
    "micro-manager": ("pymmcore",),
    "netcdf": ("h5netcdf", "h5py", "xarray"),
    "nexus": ("h5py",),
}
FOR_A_MAKE = ("gentl", "micro-manager")
NOT_FOR_USERS = ("dev", "docs")

FINGER = 'preset = "flat-70x35"\nname = "small finger"\n[camera]\nwidth_px = 512\nheight_px = 384\n'


@pytest.fixture(scope="package", autouse=True)
def no_extras(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Hide the packages that `make demo` does not install, in this process and its children.

    So no verb can need one. Drivers of particular makes may: their packages are not hidden.
    """
    hidden = [name for extra, names in PACKAGES_OF_EXTRAS.items() if extra not in FOR_A_MAKE for name in names]
    folder = tmp_path_factory.mktemp("no-extras")
    (folder / "sitecustomize.py").write_text(f"import sys\nsys.modules.update(dict.fromkeys({hidden!r}))\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        for name in hidden:
            patch.setitem(sys.modules, name, None)
        end_child()  # a parser that was started before would see them still
        yield
    end_child()


@pytest.fixture(scope="package")
def lab(no_extras: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with rig, plan and finger files, a session, its bands, and made-up records; tests only read it."""
    folder = tmp_path_factory.mktemp("lab")
    rig = simulated_rig("red", width_px=320, height_px=256)
    write_rig(rig, folder / "rig.toml")
    write_plan(paint_plan("red", rig.camera), folder / "plan.toml")
    (folder / "finger.toml").write_text(FINGER)
    origin = provenance("pytest")
    linear, encoded = with_known_camera(press()), press("unknown")
    for name, record in {
        "press": linear,
        "black-press": press(level=0.0),
        "encoded-press": encoded,
        "capture": capture_of(linear, 50.0),
        "cut-capture": capture_of(linear, 50.0, slice(0, 40)),
        "encoded-capture": capture_of(encoded, 0.5, encoding="unknown"),
        "sweep": sweep(),
        "short-sweep": sweep(last_deg=20.0),
    }.items():
        write_record(record, folder / f"{name}.json", origin)
    succeed(f"capture {folder}/plan.toml --rig {folder}/rig.toml --out {folder}/session")
    succeed(f"radiometry {folder}/session --out {folder}/bands.json")
    succeed(f"compare {folder}/press.json {folder}/capture.json --out {folder}/report.json")
    succeed(f"compare {folder}/encoded-press.json {folder}/encoded-capture.json --out {folder}/encoded-report.json")
    return folder


@pytest.fixture(scope="package")
def paints(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with red/paint.json (fitted, seed 5) and green/paint.json (a copy: same name, another folder)."""
    folder = tmp_path_factory.mktemp("paints")
    succeed(f"fit {lab}/bands.json --seed 5 --out {folder}/red/paint.json")
    shutil.copytree(folder / "red", folder / "green")
    return folder


@pytest.fixture(scope="package")
def rendered(lab: Path, paints: Path) -> Path:
    """Folder of the paints with press.json and sweep.json simulated from them."""
    finger = f"{lab}/finger.toml --paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    succeed(f"simulate render {finger} --engine scalar --samples 4 --seed 6 --out {paints}/press.json")
    succeed(f"simulate sweep {finger} --engine scalar --samples 40 --seed 6 --angles 0:90:30 --out {paints}/sweep.json")
    return paints
