"""Pytest plugin that runs the contracts on the devices of a rig file.

``pytest -p rigs.contracts.plugin --pyargs rigs.contracts --rig my-rig.toml``
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from data_schemas import CameraSettings, FilterWheelSettings, FinrayError, RigFile
from data_schemas.storage import read_toml
from rigs import Camera, FilterWheel, Light, TerminalOperator, lone_camera, lone_lamp, lone_laser, lone_wheel

HERE = Path(__file__).parent
SUITE = "devices.py"
RIG = pytest.StashKey[tuple[RigFile, Path]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("finray", "contracts of calibration rigs")
    group.addoption("--rig", type=Path, metavar="RIG", help="rig file (TOML) whose devices are tested")
    group.addoption(
        "--with-laser",
        action="store_true",
        help="switch the laser of the rig on for moments: box closed, goggles on everyone in the room",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Read the rig file."""
    path: Path | None = config.getoption("--rig")
    if path is None:
        return
    try:
        config.stash[RIG] = read_toml(path, RigFile), path.parent
    except FinrayError as error:
        raise pytest.UsageError(str(error)) from error


def pytest_report_header(config: pytest.Config) -> list[str]:
    """Say what is tested, and the safety line."""
    if RIG not in config.stash:
        return []
    rig, _ = config.stash[RIG]
    laser = rig.laser
    label = f"{laser.wavelength_nm:g} nm, {laser.power_mw:g} mW, class {laser.laser_class}"
    shines = config.getoption("--with-laser")
    return [
        f"rig: {rig.name}; the filter wheel turns and the lamp is switched",
        f"laser ({label}): "
        + ("IS SWITCHED ON; close the box, wear goggles" if shines else "stays off, without --with-laser"),
    ]


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    """Collect the suite, whose file is not named as tests are."""
    if file_path.parent != HERE or file_path.name != SUITE or RIG not in parent.config.stash:
        return None
    return pytest.Module.from_parent(parent, path=file_path)


@pytest.fixture(scope="session")
def rig_and_folder(request: pytest.FixtureRequest) -> tuple[RigFile, Path]:
    """Return the rig, and where relative paths in its file start."""
    return request.config.stash[RIG]


@pytest.fixture(scope="session")
def camera_settings(rig_and_folder: tuple[RigFile, Path]) -> CameraSettings:
    """Return the camera of the rig file."""
    return rig_and_folder[0].camera


@pytest.fixture(scope="session")
def wheel_settings(rig_and_folder: tuple[RigFile, Path]) -> FilterWheelSettings:
    """Return the filter wheel of the rig file."""
    return rig_and_folder[0].filter_wheel


@pytest.fixture(scope="class")
def camera(rig_and_folder: tuple[RigFile, Path]) -> Iterator[Camera]:
    """Open the camera."""
    with lone_camera(*rig_and_folder) as device:
        yield device


@pytest.fixture(scope="class")
def wheel(rig_and_folder: tuple[RigFile, Path]) -> Iterator[FilterWheel]:
    """Open the filter wheel."""
    with lone_wheel(*rig_and_folder, TerminalOperator()) as device:
        yield device


@pytest.fixture(scope="class")
def laser(request: pytest.FixtureRequest, rig_and_folder: tuple[RigFile, Path]) -> Iterator[Light]:
    """Open the laser, if it may be switched on."""
    if not rig_and_folder[0].is_simulated and not request.config.getoption("--with-laser"):
        pytest.skip("LASER NOT TESTED: it is switched on only with --with-laser; box closed, goggles on everyone")
    with lone_laser(*rig_and_folder) as device:
        yield device


@pytest.fixture(scope="class")
def lamp(rig_and_folder: tuple[RigFile, Path]) -> Iterator[Light]:
    """Open the lamp."""
    with lone_lamp(*rig_and_folder, TerminalOperator()) as device:
        yield device
