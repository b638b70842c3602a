"""A valid example of every kind of file, and the reader that the command line takes it through."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile

from data_schemas.storage import write_record

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
Run = Callable[[Path], object]


@dataclass(frozen=True, slots=True)
class Reader:
    """Files in a folder, which of them are mutated (glob patterns), and what is run on the folder."""

    name: str
    make: Callable[[Path], object]
    files: tuple[str, ...]
    run: Run
    every: int = 1
    """Of so many rounds one runs it: a whole comparison takes seconds."""


def _command(arguments: str) -> Run:
    """Return what runs ``finray ARGUMENTS`` and raises what ended it; {f} is the folder."""

    def run(folder: Path) -> None:
        from tests.command_line.running import finray

        outcome = finray(arguments.format(f=folder))
        if outcome.status == 2:
            raise Refused(outcome.err)

    return run


class Refused(Exception):  # noqa: N818
    """The command line refused the input with one line."""


@cache
def _results() -> Any:
    from tests.documentation.example_records import example_results

    return example_results()


def _records(folder: Path) -> None:
    from tests.command_line.records import capture_of, press, sweep, with_known_camera
    from tests.documentation.example_records import example_decision

    results = _results()
    red = results.paints["red"]  # a session, its bands and its fit
    made = with_known_camera(press())
    for name, record in {
        "session": red.session,
        "bands": red.bands,
        "paint": red.calibration,
        "press": made,
        "capture": capture_of(made, 50.0),
        "sweep": sweep(),
        "report": results.report,
        "decision": example_decision("tie"),
    }.items():
        write_record(record, folder / f"{name}.json", results.provenance)


def _record(name: str, kind: str, arguments: str = "", every: int = 1) -> Reader:
    def make(folder: Path) -> None:
        made = _whole_records()
        for path in made.iterdir():
            shutil.copy(path, folder / path.name)

    def run(folder: Path) -> None:
        from data_schemas.storage import _records as storage

        storage.read_record(folder / f"{name}.json", _kind(kind))
        if arguments:
            _command(arguments)(folder)

    verb = f", {arguments.partition(' ')[0]}" if every > 1 else ""
    return Reader(f"record {name}{verb}", make, (f"{name}.json", f"{name}.*.npz"), run, every)


@cache
def _whole_records() -> Path:
    from tempfile import mkdtemp

    folder = Path(mkdtemp(prefix="finray-fuzz-"))
    _records(folder)
    return folder


def _kind(name: str) -> Any:
    from data_schemas.json_schemas import STORED

    return next(kind for kind in STORED if kind.__name__ == name)


def _zipped(folder: Path) -> None:
    import zipfile

    with zipfile.ZipFile(folder / "c.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(_whole_records().glob("capture.*")):
            archive.write(path, f"set/{path.name.replace('capture.json', 'one.capture.json')}")


def _design(folder: Path) -> None:
    from sim import design_toml, preset_design

    (folder / "finger.toml").write_text(design_toml(preset_design("flat-70x35")))
    (folder / "short.toml").write_text(
        'preset = "baby-48x18"\nname = "short"\n[camera]\nwidth_px = 64\nheight_px = 48\n'
    )


def _read_designs(folder: Path) -> None:
    from sim import read_design

    for name in ("finger", "short"):
        read_design(folder / f"{name}.toml")


def _rig(folder: Path) -> None:
    from rigs import paint_plan, simulated_rig, write_plan, write_rig

    rig = simulated_rig("red", width_px=320, height_px=256)
    write_rig(rig, folder / "rig.toml")
    write_plan(paint_plan("red", rig.camera), folder / "plan.toml")


def _tactile(folder: Path) -> None:
    from tests.capture.finger_session import PLAN, RIG

    (folder / "rig.toml").write_text(RIG)
    (folder / "plan.toml").write_text(
        PLAN[: PLAN.index("[[presses]]")].replace("exposures_s", 'poses_csv = "poses.csv"\nexposures_s')
    )
    (folder / "poses.csv").write_text(
        "position_mm,depth_mm,position_uncertainty_mm,depth_uncertainty_mm,tilt_uncertainty_deg\n"
        "35.02,0.998,0.01,0.005,\n40.01,1.501,0.01,0.005,0.2\n"
    )


def _read_tactile(folder: Path) -> None:
    from data_schemas import TactilePlan, TactileRig
    from data_schemas.storage import read_toml
    from rigs.capture import planned_presses

    read_toml(folder / "rig.toml", TactileRig)
    planned_presses(read_toml(folder / "plan.toml", TactilePlan), folder)


def _curves(folder: Path) -> None:
    nm = np.arange(400, 701, 10)
    bell = np.exp(-0.5 * ((nm - 550) / 40.0) ** 2)
    rows = "".join(f"{x},{20 * y + 1:.3f},{40 * y:.3f},{10 * y + 2:.3f}\n" for x, y in zip(nm, bell, strict=True))
    (folder / "camera.csv").write_text("wavelength_nm,red_percent,green_percent,blue_percent\n# made up\n" + rows)
    rows = "".join(f"{x},{0.9 * y:.4f}\n" for x, y in zip(nm, bell, strict=True))
    (folder / "filter.csv").write_text("wavelength_nm,transmission\n" + rows)
    axis = np.arange(400, 701, 20)
    matrix = np.where(axis[:, None] == axis, 0.5, np.where(axis[:, None] > axis, 0.01, 0.0))
    lines = [f"{nm}," + ",".join(f"{v:g}" for v in row) for nm, row in zip(axis, matrix, strict=True)]
    header = "emission_nm," + ",".join(map(str, axis))
    (folder / "matrix.csv").write_text("\n".join([header, *lines]) + "\n")


def _read_curves(folder: Path) -> None:
    from data_schemas.storage import read_camera_response, read_donaldson_matrix, read_filter_curve

    read_camera_response(folder / "camera.csv")
    read_filter_curve(folder / "filter.csv")
    read_donaldson_matrix(folder / "matrix.csv")


def _force(folder: Path) -> None:
    rows = "".join(f"{0.1 * k:.2f},{0.3 * k**1.5:.4f},0.01\n" for k in range(12))
    (folder / "force.csv").write_text("# a bench\ndisplacement_mm,force_n,force_uncertainty_n\n" + rows)
    (folder / "pairs.csv").write_text("name,simulated,captured\na,s/a.json,c/a.json\nb,s/b.json,c/b.json\n")


def _read_force(folder: Path) -> None:
    from data_schemas import CompareError
    from data_schemas.storage import read_csv
    from finray_calib.compare import pairs_of_rows
    from finray_calib.exchange import read_force_csv

    read_force_csv(folder / "force.csv")
    header, rows = read_csv(folder / "pairs.csv", "a CSV file", CompareError)
    pairs_of_rows([dict(zip(header, cells, strict=False)) for _, cells in rows])


def _lens(folder: Path) -> None:
    from finray_calib.exchange import calibration_yaml
    from tests.simulate.test_opencv_camera import FISHEYE, PINHOLE

    (folder / "lens.yaml").write_bytes(calibration_yaml(PINHOLE))
    (folder / "fisheye.yaml").write_bytes(calibration_yaml(FISHEYE))


def _read_lens(folder: Path) -> None:
    from sim.optics import read_calibration

    for name in ("lens", "fisheye"):
        read_calibration(folder / f"{name}.yaml")


def _taxim(folder: Path) -> None:
    from tests.exchange.ball_press_folders import write_taxim

    write_taxim(folder / "t", 3)


def _catalog(folder: Path) -> None:
    from tests.exchange.ball_press_folders import write_catalog, write_circles

    write_catalog(folder / "g", 2)
    write_circles(folder / "c", 2)


def _read_balls(folder: Path) -> None:
    from finray_calib.exchange import read_ball_presses
    from tests.exchange.ball_press_folders import BALL_DIAMETER_MM, MM_PER_PX

    read_ball_presses(folder / "g", MM_PER_PX)
    read_ball_presses(folder / "c", MM_PER_PX, BALL_DIAMETER_MM)


def _pi(folder: Path) -> None:
    from tests.exchange.test_raspberry_pi_folder import CAMERA, bgg_r_counts, press_folder, write_dng
    from tests.radiometry.libcamera_documents import version_2

    raw = press_folder(folder / "raw")
    for name, rgb in CAMERA.items():
        write_dng(raw / f"{name}.dng", bgg_r_counts(rgb))
    (folder / "imx219.json").write_text(json.dumps(version_2()))


def _bands_folder(folder: Path) -> None:
    from tests.exchange.band_folders import write_folder

    write_folder(folder / "b", "Bayer RGGB")


def _signals(folder: Path) -> None:
    from tests.exchange.signal_tables import CENTERS_NM, measured, readings, table

    described = {"center_nm": np.array(CENTERS_NM), "fwhm_nm": np.full(len(CENTERS_NM), 10.0)}
    (folder / "s.csv").write_text(table(described | measured(readings())))


def _nine_dtact(folder: Path) -> None:
    shutil.copytree(SHARED / "tactile" / "9dtact" / "sensor_1", folder / "n")


def _images(folder: Path) -> None:
    from tests.capture.drivers.test_image_folder import packed_dng

    counts = np.random.default_rng(1).integers(16, 1000, (64, 96)).astype(np.uint16)
    (folder / "packed.dng").write_bytes(packed_dng(counts))
    tifffile.imwrite(folder / "plain.tiff", counts)
    cv2.imwrite(str(folder / "grey.png"), counts)


def _read_images(folder: Path) -> None:
    from rigs.cameras import read_raw
    from rigs.cameras._image_files import read_exposure_s

    for name in ("packed.dng", "plain.tiff", "grey.png"):
        read_exposure_s(folder / name)
        read_raw(folder / name)


def _packed_tiff(folder: Path) -> None:
    counts = np.random.default_rng(1).integers(16, 1000, (64, 96)).astype(np.uint16)
    tifffile.imwrite(folder / "packed.tiff", counts, compression="zlib")


def _read_packed_tiff(folder: Path) -> None:
    from rigs.cameras import read_raw

    read_raw(folder / "packed.tiff")


def _pictures(folder: Path) -> None:
    picture = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (64, 96, 3)).astype(np.uint8), (0, 0), 3)
    for name in ("board.png", "board.jpg"):
        cv2.imwrite(str(folder / name), picture)


def _read_pictures(folder: Path) -> None:
    from finray_calib.exchange import read_board_picture

    for name in ("board.png", "board.jpg"):
        read_board_picture(folder / name)


def _image_folder(folder: Path) -> None:
    counts = np.random.default_rng(1).integers(16, 1000, (64, 96)).astype(np.uint16)
    for name in "ab":
        tifffile.imwrite(folder / f"{name}.tiff", counts)
    (folder / "frames.csv").write_text("file,exposure_s\na.tiff,0.01\nb.tiff,0.02\n")


def _read_image_folder(folder: Path) -> None:
    from data_schemas import CameraSettings
    from rigs.cameras.image_folder import open_camera

    camera = CameraSettings(driver="folder", address=str(folder), width_px=96, height_px=64, bit_depth=10)
    with open_camera(camera, Path()) as opened:
        opened.expose(0.01, 10.0)


def _stl(folder: Path) -> None:
    from sim.surface_meshes import stl_bytes
    from tests.command_line.mistakes import CUBE, FACETS

    (folder / "body.stl").write_bytes(stl_bytes(FACETS, CUBE, "body"))
    lines = ["solid cube"]
    for triangle in CUBE[FACETS]:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in triangle)]
        lines += ["endloop", "endfacet"]
    (folder / "text.stl").write_text("\n".join([*lines, "endsolid cube"]))


def _read_stl(folder: Path) -> None:
    from sim.mechanics._rigid_bodies import read_body

    read_body(folder / "body.stl")
    read_body(folder / "text.stl")


_COATS = ("coat.npy", "coat.png")


def _sensor(folder: Path) -> None:
    import cv2
    import numpy as np

    depth = 0.5 * np.exp(-((np.arange(41)[:, None] - 20.0) ** 2 + (np.arange(41) - 20.0) ** 2) / 30.0)
    np.save(folder / "coat.npy", depth)
    cv2.imwrite(str(folder / "coat.png"), (1000.0 * depth).astype(np.uint16))
    for name in _COATS:
        surface = f'[surface]\nfile = "{name}"\nstep_mm = 0.4\nunit_mm = {1.0 if name == "coat.npy" else 0.001}\n'
        (folder / f"{name}.toml").write_text(f'kind = "sensor"\npreset = "gelsight-flat"\n{surface}')


def _read_sensor(folder: Path) -> None:
    from sim import read_sensor
    from sim.experiments import pressed_coat

    for name in _COATS:
        pressed_coat(read_sensor(folder / f"{name}.toml"), folder)


def _engines(folder: Path) -> None:
    from tests.exchange import test_abaqus_results as abaqus
    from tests.exchange import test_calculix_results as calculix

    (folder / "x.frd").write_text(
        calculix.HEAD + calculix.NODES + calculix.FIRST + calculix.SECOND + calculix.TOUCH + " 9999\n"
    )
    (folder / "x.dat").write_text(calculix.DAT)
    (folder / "x.fil").write_text(abaqus.sample())


def _read_engines(folder: Path) -> None:
    from sim.mechanics.other_engines import read_fil
    from sim.mechanics.other_engines._calculix import read_frd, read_totals

    read_frd(folder / "x.frd")
    read_totals(folder / "x.dat")
    read_fil(folder / "x.fil")


def _exr(folder: Path) -> None:
    import OpenEXR

    nm = [f"{400 + 10 * k},000000nm" for k in range(5)]
    pairs = [(i, j) for i in range(5) for j in range(i, 5)]
    names = [f"T.{nm[i]}" if i == j else f"T.{nm[i]}.{nm[j]}" for i, j in pairs]
    matrix = {name: np.full((1, 1), 0.1, np.float32) for name in names}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, matrix).write(
        str(folder / "paint.exr")
    )


def _read_exr(folder: Path) -> None:
    from finray_calib.exchange import read_bispectral_exr

    read_bispectral_exr(folder / "paint.exr")


def _journal(folder: Path) -> None:
    _rig(folder)
    _command("capture {f}/plan.toml --rig {f}/rig.toml --out {f}/s")(folder)
    (folder / "s" / "session.json").unlink()
    for path in (folder / "s").glob("SHA256*"):
        path.unlink()


def _read_journal(folder: Path) -> None:
    from rigs.capture import read_interrupted

    read_interrupted(folder / "s")


def _session(folder: Path) -> None:
    _rig(folder)
    _command("capture {f}/plan.toml --rig {f}/rig.toml --out {f}/s")(folder)


READERS: tuple[Reader, ...] = (
    _record("session", "CaptureSession"),
    _record("bands", "BandSignals"),
    _record("paint", "PaintCalibration", "export {f}/paint.json --format csv --out {f}/out.csv"),
    _record("press", "SimulatedPress"),
    _record("capture", "TactileCapture"),
    _record("press", "SimulatedPress", "compare {f}/press.json {f}/capture.json --out {f}/out.json", every=20),
    _record("capture", "TactileCapture", "compare {f}/press.json {f}/capture.json --out {f}/out.json", every=20),
    _record("sweep", "LightAngleSweep", "decide {f}/sweep.json --out {f}/out.json"),
    _record(
        "report",
        "PhotometricErrorReport",
        "decide {f}/sweep.json --photometric-error {f}/report.json --out {f}/out.json",
    ),
    _record("decision", "LightAngleDecision"),
    Reader("design (TOML)", _design, ("*.toml",), _read_designs),
    Reader(
        "rig and plan (TOML)",
        _rig,
        ("*.toml",),
        _command("capture {f}/plan.toml --rig {f}/rig.toml --dry-run --out {f}/out"),
    ),
    Reader("tactile plan, rig, poses", _tactile, ("*.toml", "*.csv"), _read_tactile),
    Reader("curves and matrices (CSV)", _curves, ("*.csv",), _read_curves),
    Reader("forces and pairs (CSV)", _force, ("*.csv",), _read_force),
    Reader("OpenCV calibration (YAML)", _lens, ("*.yaml",), _read_lens),
    Reader("Taxim folder", _taxim, ("t/dataPack.npz", "t/params.json"), _command("import taxim {f}/t --out {f}/out")),
    Reader("ball presses", _catalog, ("g/*.csv", "g/*.png", "g/*/*/*", "c/*"), _read_balls),
    Reader(
        "Raspberry Pi folder",
        _pi,
        ("raw/*", "imx219.json"),
        _command("import raspberry-pi {f}/raw --tuning {f}/imx219.json --out {f}/out.json"),
    ),
    Reader(
        "band images",
        _bands_folder,
        ("b/bands.toml", "b/*.tif", "b/white/*"),
        _command("import bands {f}/b --out {f}/out.json"),
    ),
    Reader(
        "band signals (CSV)", _signals, ("s.csv",), _command("import signals {f}/s.csv --laser-nm 450 --out {f}/o.json")
    ),
    Reader(
        "9DTact folder", _nine_dtact, ("n/**/*.npy", "n/**/*.png"), _command("import 9dtact {f}/n --out {f}/out.json")
    ),
    Reader("captures in a zip", _zipped, ("c.zip",), _command("export captures {f}/c.zip --out {f}/out.zip")),
    Reader("raw images (DNG, TIFF, PNG)", _images, ("*",), _read_images),
    Reader("packed TIFF", _packed_tiff, ("*",), _read_packed_tiff),
    Reader("pictures (PNG, JPEG)", _pictures, ("*",), _read_pictures),
    Reader("folder as camera", _image_folder, ("*",), _read_image_folder),
    Reader("indenter (STL)", _stl, ("*.stl",), _read_stl),
    Reader("sensor and its coat (TOML, NPY, PNG)", _sensor, ("*",), _read_sensor),
    Reader("CalculiX and Abaqus results", _engines, ("*",), _read_engines),
    Reader("bispectral image (EXR)", _exr, ("*.exr",), _read_exr),
    Reader("journal", _journal, ("s/journal.jsonl",), _read_journal),
    Reader(
        "session folder", _session, ("s/session.json", "s/frames/*"), _command("radiometry {f}/s --out {f}/out.json")
    ),
)
