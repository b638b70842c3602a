"""Pytest plugin that runs the contracts on the devices of a rig file: ``pytest --pyargs rigs.contracts --rig RIG``.

An installation offers it to every run of pytest, so that nothing but pytest is imported before a rig file is named.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

if TYPE_CHECKING:
    from data_schemas import (
        CameraSettings,
        FilterWheelSettings,
        LoadCellSettings,
        RigFile,
        StageSettings,
        TactileRig,
    )
    from rigs import Camera, FilterWheel, Light, LoadCell, Stage
    from rigs.capture import OpenTactileRig

HERE = Path(__file__).parent
SUITE = "devices.py"


class NamedRig(NamedTuple):
    """The rig file of ``--rig``, and where relative paths in it start."""

    rig: "RigFile | TactileRig"
    folder: Path

    @property
    def whole(self) -> "RigFile":
        """The rig, where it has more than a camera.

        Raises
        ------
        RefusedError
            It is one of tactile sessions; the tests of what it lacks are deselected.
        """
        from data_schemas import RefusedError, RigFile

        if not isinstance(self.rig, RigFile):
            raise RefusedError(f"rig '{self.rig.name}': a rig of a tactile session has no wheel and no light")
        return self.rig

    @property
    def finger(self) -> "TactileRig":
        """The rig, where it is one of tactile sessions with a stage.

        Raises
        ------
        RefusedError
            It is not; the tests of what it lacks are deselected.
        """
        from data_schemas import RefusedError, TactileRig

        if not isinstance(self.rig, TactileRig) or self.rig.stage is None:
            raise RefusedError(f"rig '{self.rig.name}': has no stage with a load cell")
        return self.rig


RIG = pytest.StashKey[NamedRig]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("finray", "contracts of calibration rigs (pytest --pyargs rigs.contracts --rig RIG)")
    group.addoption("--rig", type=Path, metavar="RIG", help="rig file (TOML) whose devices are tested")
    group.addoption(
        "--with-laser",
        action="store_true",
        help="switch the laser of the rig on briefly; first close the box and let everyone in the room wear goggles",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Read the rig file, and see that its drivers are there."""
    path: Path | None = config.getoption("--rig")
    if path is None:
        return
    from data_schemas import FinrayError, RigFile, TactileRig
    from data_schemas.storage import read_toml, read_toml_tables
    from rigs import rig_drivers

    try:
        has_a_wheel = "filter_wheel" in read_toml_tables(path)
        rig = read_toml(path, RigFile) if has_a_wheel else read_toml(path, TactileRig)
        rig_drivers(rig)
    except FinrayError as error:
        raise pytest.UsageError(str(error)) from error
    config.stash[RIG] = NamedRig(rig, path.parent)


def pytest_report_header(config: pytest.Config) -> list[str]:
    """Say what is tested."""
    return [f"rig: {config.stash[RIG].rig.name}"] if RIG in config.stash else []


def pytest_report_collectionfinish(config: pytest.Config, items: list[pytest.Item]) -> list[str]:
    """Say what the selected tests will move and light."""
    if RIG not in config.stash:
        return []
    classes = {found.name for item in items if item.path == HERE / SUITE and (found := item.getparent(pytest.Class))}
    return [line for of, line in _announced(config) if of in classes]


def _announced(config: pytest.Config) -> Iterator[tuple[str, str]]:
    """Yield each class of the suite with what it does to its device."""
    from data_schemas import RigFile
    from rigs import device_title

    rig, _ = config.stash[RIG]
    yield "TestCamera", f"{device_title('camera', rig.camera)}; takes frames, and its exposure is changed"
    if isinstance(rig, RigFile):
        laser = rig.laser
        label = f"{laser.wavelength_nm:g} nm, {laser.power_mw:g} mW, class {laser.laser_class}"
        shines = (
            "IS SWITCHED ON; close the box, wear goggles" if _may_shine(config) else "stays off, without --with-laser"
        )
        wheel = device_title("filter wheel", rig.filter_wheel)
        yield "TestFilterWheel", f"{wheel}; TURNS through all of its slots"
        yield "TestLamp", f"{device_title('lamp', rig.lamp)}; IS SWITCHED ON briefly"
        yield "TestLaser", f"{device_title('laser', laser)} ({label}); {shines}"
    elif rig.stage is not None and rig.load_cell is not None:
        stage, cell = device_title("stage", rig.stage), device_title("load cell", rig.load_cell)
        yield "TestStage", f"{stage}; IS HOMED and MOVES some steps from clear_mm: keep hands away"
        yield "TestLoadCell", f"{cell}; is read"


def _may_shine(config: pytest.Config) -> bool:
    """Whether the laser may be switched on: it was asked for, or there is none."""
    rig = config.stash[RIG].whole
    return bool(config.getoption("--with-laser")) or rig.is_simulated


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    """Collect the suite, whose file is not named as tests are."""
    if file_path.parent != HERE or file_path.name != SUITE or RIG not in parent.config.stash:
        return None
    return pytest.Module.from_parent(parent, path=file_path)


OF_A_BENCH = ("TestFilterWheel", "TestLaser", "TestLamp")
OF_A_FINGER = ("TestStage", "TestLoadCell")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the tests of devices that a rig of its kind does not have."""
    if RIG not in config.stash:
        return
    from data_schemas import RigFile

    rig = config.stash[RIG].rig
    lacks = OF_A_FINGER if isinstance(rig, RigFile) else OF_A_BENCH if rig.stage else (*OF_A_BENCH, *OF_A_FINGER)

    def is_of_none(item: pytest.Item) -> bool:
        of = item.getparent(pytest.Class)
        return item.path == HERE / SUITE and of is not None and of.name in lacks

    left = [item for item in items if is_of_none(item)]
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if not is_of_none(item)]


@pytest.fixture(scope="session")
def named_rig(request: pytest.FixtureRequest) -> NamedRig:
    """Return the rig, and where relative paths in its file start."""
    return request.config.stash[RIG]


@pytest.fixture(scope="session")
def camera_settings(named_rig: NamedRig) -> "CameraSettings":
    """Return the camera of the rig file."""
    return named_rig.rig.camera


@pytest.fixture(scope="session")
def wheel_settings(named_rig: NamedRig) -> "FilterWheelSettings":
    """Return the filter wheel of the rig file."""
    return named_rig.whole.filter_wheel


@pytest.fixture(scope="session")
def stage_settings(named_rig: NamedRig) -> "StageSettings | None":
    """Return the stage of the rig file."""
    return named_rig.finger.stage


@pytest.fixture(scope="session")
def load_cell_settings(named_rig: NamedRig) -> "LoadCellSettings | None":
    """Return the load cell of the rig file."""
    return named_rig.finger.load_cell


@pytest.fixture(scope="class")
def pressing(named_rig: NamedRig) -> "Iterator[OpenTactileRig]":
    """Open the stage, and the load cell that guards it."""
    from rigs.capture import open_tactile_rig

    rig = named_rig.finger
    with open_tactile_rig(rig, named_rig.folder, only="stage and load cell") as opened:
        yield opened


@pytest.fixture(scope="class")
def stage(pressing: "OpenTactileRig") -> "Stage | None":
    """Return the stage."""
    return pressing.stage


@pytest.fixture(scope="class")
def stage_guard(pressing: "OpenTactileRig", named_rig: NamedRig) -> "Callable[[], None]":
    """Return what reads the load cell, and raises at a force where nothing should touch."""
    from rigs.capture import free_travel_guard

    return free_travel_guard(pressing, named_rig.finger, named_rig.folder)


@pytest.fixture(scope="class")
def load_cell(named_rig: NamedRig) -> "Iterator[LoadCell | None]":
    """Open the load cell."""
    from rigs.capture import open_tactile_rig

    with open_tactile_rig(named_rig.finger, named_rig.folder, only="load cell") as opened:
        yield opened.load_cell


@pytest.fixture(scope="class")
def camera(named_rig: NamedRig) -> "Iterator[Camera]":
    """Open the camera."""
    from data_schemas import TactileRig
    from rigs import open_rig_camera
    from rigs.capture import open_tactile_rig

    if isinstance(named_rig.rig, TactileRig) and named_rig.rig.is_simulated:
        with open_tactile_rig(named_rig.rig, named_rig.folder) as opened:
            yield opened.camera_there()
        return
    with open_rig_camera(named_rig.rig, named_rig.folder) as device:
        yield device


@pytest.fixture(scope="class")
def wheel(request: pytest.FixtureRequest, named_rig: NamedRig) -> "Iterator[FilterWheel]":
    """Open the filter wheel."""
    from rigs import TerminalOperator, open_rig_wheel

    _require_operator(request.config, named_rig.whole.filter_wheel.driver)
    with open_rig_wheel(named_rig.whole, named_rig.folder, TerminalOperator()) as device:
        yield device


@pytest.fixture(scope="class")
def laser(request: pytest.FixtureRequest, named_rig: NamedRig) -> "Iterator[Light]":
    """Open the laser, if it may be switched on."""
    from rigs import open_rig_laser

    rig = named_rig.whole
    if not _may_shine(request.config):
        pytest.skip("LASER NOT TESTED: it is switched on only with --with-laser; box closed, goggles on everyone")
    with open_rig_laser(rig, named_rig.folder) as device:
        yield device


@pytest.fixture(scope="class")
def lamp(request: pytest.FixtureRequest, named_rig: NamedRig) -> "Iterator[Light]":
    """Open the lamp."""
    from rigs import TerminalOperator, open_rig_lamp

    _require_operator(request.config, named_rig.whole.lamp.driver)
    with open_rig_lamp(named_rig.whole, named_rig.folder, TerminalOperator()) as device:
        yield device


def _require_operator(config: pytest.Config, driver: str) -> None:
    """Skip what a person does by hand where pytest keeps the terminal to itself."""
    if driver == "manual" and config.getoption("capture") != "no":
        pytest.skip("NOT TESTED: the operator is asked at the terminal, and tests can ask there only with pytest -s")
