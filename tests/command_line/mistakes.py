"""Every mistake of a user that the command line must explain: what it is, the command, what must be said."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_schemas.storage import read_frame, write_frame
from sim.surface_meshes import stl_bytes
from tests.command_line.running import edit, load

CAMERA = "wavelength_nm,red_percent,green_percent,blue_percent\n"
MATRIX = "emission_nm,450,460\n"
Prepare = Callable[[Path, Path], object]


@dataclass(frozen=True, slots=True)
class Case:
    """Arguments ({lab}, {paints} and {tmp} are folders), the message, and what makes the input bad."""

    what: str
    arguments: str
    message: str
    prepare: Prepare | None = None


def edited(name: str, old: str, new: str) -> Prepare:
    """Copy a file of the laboratory to {tmp} with one text replaced."""

    def prepare(lab: Path, tmp: Path) -> None:
        shutil.copy(lab / name, tmp / name)
        edit(tmp / name, old, new)

    return prepare


def curve(rows: str, header: str = CAMERA) -> Prepare:
    """Put a rig with a camera response of these rows into {tmp}."""

    def prepare(lab: Path, tmp: Path) -> None:
        (tmp / "camera.csv").write_text(header + rows)
        edited("rig.toml", 'response = "assumed"', 'response = "camera.csv"')(lab, tmp)

    return prepare


def session(change: Callable[[Path], object]) -> Prepare:
    """Copy the session to {tmp} and change it."""
    return lambda lab, tmp: change(shutil.copytree(lab / "session", tmp / "session"))


def frames(folder: Path, kind: str, filter_name: str | None) -> list[dict[str, str]]:
    """Return the stored frames of one kind through one filter."""
    stored = load(folder / "session.json")["record"]["frames"]
    return [f for f in stored if (f["frame_type"], f["filter_name"]) == (kind, filter_name)]


def without_a_frame(folder: Path) -> None:
    (folder / frames(folder, "white", "532")[0]["file"]).unlink()


def with_a_changed_bit(folder: Path) -> None:
    path = folder / frames(folder, "white", "532")[0]["file"]
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def with_a_saturated_band(folder: Path) -> None:
    for frame in frames(folder, "fluorescence", "600"):
        path = folder / frame["file"]
        full = np.full_like(read_frame(path, frame["sha256"]), 1023)
        path.unlink()
        edit(folder / "session.json", frame["sha256"], write_frame(path, full, "saturated"))


def without_array_file(lab: Path, tmp: Path) -> None:
    shutil.copy(lab / "capture.json", tmp / "capture.json")


CUBE = np.array([[x, y, z] for x in (0.0, 5.0) for y in (0.0, 5.0) for z in (0.0, 5.0)])
FACETS = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def with_indenter(vertices_mm: np.ndarray, triangles: np.ndarray) -> Prepare:
    """Write a finger into {tmp} whose indenter is this STL."""

    def prepare(lab: Path, tmp: Path) -> None:
        (tmp / "body.stl").write_bytes(stl_bytes(triangles, vertices_mm, "body"))
        design('[indenter]\nshape = "mesh"\nfile = "body.stl"')(lab, tmp)

    return prepare


def design(tables: str) -> Prepare:
    """Write a finger with these tables into {tmp}."""
    return file("finger.toml", f'preset = "flat-70x35"\nname = "bad finger"\n{tables}\n')


def file(name: str, text: str) -> Prepare:
    """Write a text file into {tmp}."""
    return lambda _, tmp: (tmp / name).write_text(text)


CAPTURE = "capture {lab}/plan.toml --rig {lab}/rig.toml"
BAD_PLAN = "capture {tmp}/plan.toml --rig {lab}/rig.toml"
BAD_RIG = "capture {lab}/plan.toml --rig {tmp}/rig.toml"
MECHANICS = "simulate press {tmp}/finger.toml"
SIMULATE = "simulate render {lab}/finger.toml --paint red={paints}/red/paint.json --engine scalar"
BOTH = SIMULATE + " --paint green={paints}/green/paint.json"
SWEEP = BOTH.replace("simulate render", "simulate sweep")
BAD_FINGER = BOTH.replace("{lab}", "{tmp}")
STUDY = (
    'name = "one"\ndesign = "flat-70x35"\n[[vary]]\nfield = "pad.thickness_mm"\nvalues = [5.0, 6.0]\n'
    '[measure]\npress = "finite elements"\nimages = false\n'
)
NEW = "'pip install -U finray-calib'"

CASES = (
    # plan and rig
    Case(
        "no plan",
        "capture {tmp}/plan.toml --rig {lab}/rig.toml",
        r"plan\.toml: no such file; give the path of a paint plan",
    ),
    Case(
        "no rig",
        "capture {lab}/plan.toml --rig {tmp}/rig.toml",
        r"rig\.toml: no such file; give the path of a rig file",
    ),
    Case(
        "plan is a folder", "capture {lab} --rig {lab}/rig.toml", r"lab\S*: is a folder; give the path of a paint plan"
    ),
    Case("folder for a rig", "rig show {lab}", r": is a folder; give the path of a rig file \(TOML\)"),
    Case("folder for a finger", "simulate press {lab}", r": is a folder; give the path of a finger design \(TOML\)"),
    Case("no session to resume", "capture --resume {tmp}", r"contains no interrupted session .*; give the folder"),
    Case("file for band images", "import bands {lab}/rig.toml", r"rig\.toml: is a file; give the folder of the images"),
    Case("half a record", "fit {tmp}/half.json", r"edited or cut off, so restore it", file("half.json", "{")),
    Case("list for a record", "fit {tmp}/list.json", r"list\.json: .*; give a record that", file("list.json", "[]")),
    Case("plan is no TOML", BAD_PLAN, r"plan\.toml: cannot be read as TOML \(.* line 1", file("plan.toml", "{}")),
    Case(
        "plan and rig exchanged",
        "capture {lab}/rig.toml --rig {lab}/plan.toml",
        r"rig\.toml: contains a rig file, but a paint plan is needed; give the path of",
    ),
    Case(
        "check plan for a rig",
        "capture {lab}/plan.toml --rig {tmp}/check.toml",
        r"check\.toml: contains the plan of a check, but a rig file is needed; give the path of the right file",
        file("check.toml", 'kind = "check"\ncheck_name = "mine"\nwheel_moves = 3\n'),
    ),
    Case(
        "unknown key",
        BAD_RIG,
        r"rig\.toml: 'filter_wheel\.filters \(entry 1\)\.fwhm': unknown key; did you mean 'fwhm_nm'\?",
        edited("rig.toml", "fwhm_nm", "fwhm"),
    ),
    Case(
        "wrong unit",
        BAD_RIG,
        r"filters \(entry 1\)\.center_nm' \(in nm\): must be at least 200, got 0\.405; correct it, and give it in nm",
        edited("rig.toml", "center_nm = 405.0", "center_nm = 0.405"),
    ),
    Case(
        "unit in the value",
        BAD_RIG,
        r"'laser\.power_mw' \(in mW\): must be a number, got '4\.5 mW'",
        edited("rig.toml", "power_mw = 4.5", 'power_mw = "4.5 mW"'),
    ),
    Case(
        "filter named twice in the rig",
        BAD_RIG,
        r"rig\.toml: 'filter_wheel': name 450 is used by two filters; give each filter a different name",
        edited("rig.toml", 'name = "405"', 'name = "450"'),
    ),
    Case(
        "filter named twice in the plan",
        BAD_PLAN,
        r"plan\.toml: filters: '450' is named twice; name each filter once",
        edited("plan.toml", "# filters = [...]", 'filters = ["450", "600", "450"] #'),
    ),
    Case(
        "filter that the rig lacks",
        BAD_PLAN,
        r"plan\.toml: plan\.filters: the rig has no filter '451'; its filters are 405, 450, 500",
        edited("plan.toml", "# filters = [...]", 'filters = ["450", "451"] #'),
    ),
    Case(
        "excitation filter that blocks the laser",
        BAD_PLAN,
        r"plan\.toml: .*filter '500' passes 495 to 505 nm, so it blocks the laser at 450 nm; name the filter that",
        edited("plan.toml", 'excitation_filter = "450"', 'excitation_filter = "500"'),
    ),
    Case(
        "empty region",
        BAD_PLAN,
        r"plan\.toml: plan\.region\.height_px: 0 px is too small; 2 to 256 px are allowed",
        edited("plan.toml", "height_px = 56", "height_px = 0"),
    ),
    Case(
        "region outside the frame",
        BAD_PLAN,
        r"plan\.toml: plan\.region: row_px = 250 with height_px = 56 ends at pixel 306, outside .* at most 256 px",
        edited("plan.toml", "row_px = 100", "row_px = 250"),
    ),
    # what an editor or another country's keyboard makes of a file
    Case(
        "decimal comma",
        BAD_PLAN,
        r"plan\.toml: cannot be read as TOML \(.*\); correct the line 'target_fraction = 0,7' \(the decimal mark",
        edited("plan.toml", "target_fraction = 0.7", "target_fraction = 0,7"),
    ),
    Case(
        "text without quotes",
        BAD_PLAN,
        r"plan\.toml: .*; correct the line 'paint_name = red' \(put text in straight quotes",
        edited("plan.toml", 'paint_name = "red"', "paint_name = red"),
    ),
    Case(
        "typographic quotes",
        BAD_PLAN,
        r"plan\.toml: .* \(write straight quotes",
        edited("plan.toml", 'paint_name = "red"', "paint_name = \u201cred\u201d"),
    ),
    Case(
        "UTF-16",
        BAD_PLAN,
        r"plan\.toml: .*; save it as UTF-8 text",
        lambda lab, tmp: (tmp / "plan.toml").write_text((lab / "plan.toml").read_text(), encoding="utf-16"),
    ),
    Case(
        "record for a plan",
        "capture {lab}/bands.json --rig {lab}/rig.toml",
        r"bands\.json: .*; it looks like a JSON file, but a TOML file is needed",
    ),
    Case(
        "half a pixel",
        BAD_PLAN,
        r"plan\.toml: 'region\.row_px': must be a whole number, got 100\.5",
        edited("plan.toml", "row_px = 100", "row_px = 100.5"),
    ),
    Case(
        "semicolons between columns",
        BAD_RIG,
        r"camera\.csv, line 2: has 2 columns, but the header has 4; correct the row",
        curve("400;1,5;2;3\n700;1;2;3\n"),
    ),
    Case("path with spaces", "capture a plan.toml", r"does not take plan\.toml; put a path with spaces in quotes; "),
    # curves
    Case("no rig given", "capture {lab}/plan.toml", r"PLAN or --rig is missing; give both, or --resume with"),
    Case("no curve file", BAD_RIG, r"no\.csv: no such file", edited("rig.toml", '"assumed"\n', '"no.csv"\n')),
    Case(
        "unsorted wavelengths",
        BAD_RIG,
        r"camera\.csv: wavelengths must increase .*: 450 nm follows 500 nm; sort the rows",
        curve("400,1,2,3\n500,1,2,3\n450,1,2,3\n700,1,2,3\n"),
    ),
    Case(
        "NaN in a curve",
        BAD_RIG,
        r"camera\.csv, line 3: '\S+' is not a finite number; correct or remove the row, or measure it again",
        curve("400,1,2,3\n500,1,nan,3\n700,1,2,3\n"),
    ),
    Case(
        "curve that ends at 420 nm",
        BAD_RIG,
        r"camera\.csv: curve 'red' covers only 380 to 420 nm, and .* of filter 450 lies outside \(at most 20 % is",
        curve("380,1,2,3\n420,1,2,3\n"),
    ),
    Case(
        "other columns",
        BAD_RIG,
        r"camera\.csv: the header is nm,r,g,b, but a camera response needs wavelength_nm,red_percent",
        curve("380,1,2,3\n720,1,2,3\n", header="nm,r,g,b\n"),
    ),
    Case(
        "plan without exposures",
        BAD_PLAN,
        r"plan\.toml: 'bracket': must have more entries, at least 1",
        edited("plan.toml", "bracket = [1.0, 0.25]", "bracket = []"),
    ),
    # session
    Case("no session folder", "radiometry {tmp}/session", r"session: no such folder; give the folder that 'finray cap"),
    Case(
        "folder that is no session",
        "radiometry {lab}",
        r"contains no capture session \(session\.json is missing\); give the folder",
    ),
    Case(
        "session not finished",
        "radiometry {tmp}/session",
        r"session: was complete .*, but session\.json is missing; restore it .*finray capture --resume",
        session(lambda folder: (folder / "session.json").unlink()),
    ),
    Case(
        "missing frame",
        "radiometry {tmp}/session",
        r"frames/\d+_white_532_\d+us\.tiff: the frame is missing; restore it from a copy, or capture the session again",
        session(without_a_frame),
    ),
    Case(
        "changed frame",
        "radiometry {tmp}/session",
        r"frames/\d+_white_532_\d+us\.tiff: the frame was changed \(its SHA-256 differs .*; restore the frame",
        session(with_a_changed_bit),
    ),
    Case(
        "saturated band",
        "radiometry {tmp}/session",
        r"session: frames/\d+_fluorescence_600_\S+: filter 600 is saturated in all channels .*lower plan\.target_fra",
        session(with_a_saturated_band),
    ),
    Case(
        "newer session",
        "radiometry {tmp}/session",
        rf"session\.json: schema_version 9 was written by a newer finray, .* reads only up to \d; update with {NEW}",
        session(lambda folder: edit(folder / "session.json", '"schema_version": 7', '"schema_version": 9')),
    ),
    # stored records
    Case(
        "no record", "fit {tmp}/bands.json", r"bands\.json: no such file; give the path of a stored record \(\.json\)"
    ),
    Case(
        "map with a family",
        "fit {lab}/bands.json --map --paint {paints}/red/paint.json --family skew_t",
        r"--family cannot be combined with --map",
    ),
    Case(
        "region's fit without map",
        "fit {lab}/bands.json --paint {paints}/red/paint.json",
        r"--paint is supported only with --map, which starts from",
    ),
    Case(
        "record is a folder",
        "fit {lab}/session",
        r"session: is a folder; give the path of a stored record \(\.json\)",
    ),
    Case(
        "wrong kind",
        "fit {paints}/red/paint.json",
        r"paint\.json: contains a paint calibration, but band signals are needed",
    ),
    Case(
        "record for its session", "radiometry {lab}/session/session.json", r"session\.json: is a file; give the folder"
    ),
    Case(
        "folder for a record",
        "trace {lab}",
        r"lab\S*: is a folder or a zip archive; give the path of .*'finray verify'",
    ),
    Case(
        "record for a folder",
        "verify {lab}/bands.json",
        r"bands\.json: is a file, not a folder \(check a record with 'finray trace",
    ),
    Case(
        "study that is none", "study show {lab}", r"holds no study\.json; give the folder that 'finray study run' wrote"
    ),
    Case(
        "rig for a record",
        "fit {lab}/rig.toml",
        r"rig\.toml: cannot be read as JSON .*; the file does not begin with \{ or \[; give the path of",
    ),
    Case(
        "misspelt option",
        "fit {lab}/bands.json --famly skew_t",
        r"'finray fit' does not take --famly skew_t; did you mean '--family'\? 'finray fit --help' lists",
    ),
    Case(
        "rig without its option", "live {lab}/rig.toml", r"does not take \S*rig\.toml; write --rig before a rig file; "
    ),
    Case(
        "file for the folder of a press",
        "import raspberry-pi {lab}/rig.toml",
        r"rig\.toml: is a file; give the folder of one press, with its images and press\.toml",
    ),
    Case(
        "two paints behind one option",
        "simulate render f.toml --paint red=a.json green=b.json",
        r"does not take green=b\.json; write --paint before each COLOUR=FILE; ",
    ),
    Case(
        "rig for a finger",
        "study finger-stiffness {lab}/rig.toml",
        r"rig\.toml: contains a rig file, but a finger design is needed; give the path of",
    ),
    Case(
        "classic sensor for a finger",
        "simulate press {tmp}/sensor.toml",
        r"sensor\.toml: contains the design of a classic sensor, but the design of a finger is needed; 'finray design",
        file("sensor.toml", 'kind = "sensor"\npreset = "digit"\n'),
    ),
    Case(
        "paint without a name",
        BAD_PLAN,
        r"plan\.toml: plan\.paint_name: is empty; give a name, which files and records will carry",
        edited("plan.toml", 'paint_name = "red"', 'paint_name = " "'),
    ),
    Case(
        "reflectance in per cent",
        BAD_RIG,
        r"'white_reference\.reflectance': must be at most 1, got 98\.0$",
        edited("rig.toml", "\nreflectance = 0.98", "\nreflectance = 98.0"),
    ),
    Case(
        "stray light in per cent",
        BAD_RIG,
        r"'band_uncertainty\.stray_light_rel': must be at most 0\.2, got 0\.3$",
        edited("rig.toml", "stray_light_rel = 0.003", "stray_light_rel = 0.3"),
    ),
    Case(
        "record with the name of a table",
        "fit {lab}/bands.json --out {tmp}/paint.csv",
        r"paint\.csv: must be a record: choose an --out that ends in \.json",
    ),
    Case(
        "record with the name of a text",
        "radiometry {lab}/session --out {tmp}/bands.txt",
        r"bands\.txt: must be a record: choose an --out that ends in \.json",
    ),
    Case(
        "decision with the name of a document",
        "decide {lab}/sweep.json --out {tmp}/angle.pdf",
        r"angle\.pdf: must be a record: choose an --out that ends in \.json",
    ),
    Case(
        "press with the name of a picture",
        MECHANICS + " --out {tmp}/press.png",
        r"press\.png: must be a record: choose an --out that ends in \.json",
        design(""),
    ),
    Case(
        "page with the name of a text",
        "fit {lab}/bands.json --out {tmp}/paint.json --report {tmp}/paint.txt",
        r"paint\.txt: must be a page: choose a --report that ends in \.html",
    ),
    Case(
        "rig with the name of a record",
        "rig init --preset simulated --out {tmp}/rig.json",
        r"rig\.json: must be a TOML file: choose an --out that ends in \.toml",
    ),
    Case(
        "format that its file name denies",
        "export {paints}/red/paint.json --format csv --out {tmp}/red.xlsx",
        r"red\.xlsx: a file of --format csv must end in \.csv; choose another --out",
    ),
    Case(
        "frames of what is no session",
        "export ome-tiff {lab} --out {tmp}/a.ome.tiff",
        r"contains no capture session \(session\.json is missing\); give the folder that 'finray capture' wrote",
    ),
    Case(
        "frames as a plain picture",
        "export ome-tiff {lab}/session --out {tmp}/a.tiff",
        r"a\.tiff: a file of ome-tiff must end in \.ome\.tiff or \.ome\.tif; choose another --out",
    ),
    Case(
        "one coat for two tins",
        "check equivalence --first {paints}/red/paint.json --second {paints}/green/paint.json --margin mode_nm=4",
        r"red/paint\.json and \S+green/paint\.json are the same calibration; give one calibration for each coat",
    ),
    Case(
        "day in words",
        "certificate {paints}/red/paint.json --out {tmp}/c.html --laboratory {tmp}/lab.toml",
        r"lab\.toml: 'references \(entry 1\)\.calibrated_on': must be a date such as 2026-03-02, .* got 'yesterday'",
        file(
            "lab.toml",
            'kind = "certificate"\nlaboratory = "one"\n[[references]]\nof = "lamp"\nnumber = "1"\nissued_by = "two"\n'
            'calibrated_on = "yesterday"\n',
        ),
    ),
    Case(
        "uncertainty in per cent",
        "design show {tmp}/finger.toml",
        r"'uncertainty_rel': 'pad\.thickness_mm' = 10: a relative standard uncertainty must be at most 1; .* 0\.05",
        design('[uncertainty_rel]\n"pad.thickness_mm" = 10.0'),
    ),
    Case(
        "study into another folder",
        "study run {tmp}/plan.toml --out {lab}",
        r"lab\S*: holds something other than a design study; choose another --out",
        file("plan.toml", STUDY),
    ),
    Case(
        "study into a file",
        "study run {tmp}/plan.toml --out {lab}/bands.json",
        r"bands\.json: is a file, but a folder is to be written there; choose another --out",
        file("plan.toml", STUDY),
    ),
    Case(
        "study compared with no folder",
        "study compare {tmp}/nothing {tmp}/neither",
        r"nothing: holds no study\.json; give the folder that 'finray study run' wrote",
    ),
    Case(
        "study of no folder",
        "study show {tmp}/nothing",
        r"nothing: holds no study\.json; give the folder that 'finray study run' wrote",
    ),
    Case(
        "depths of a data set in metres",
        "study dataset flat-70x35 --depth-mm 0.0003 0.002 --out {tmp}/set",
        r"depth_mm: the range begins at 0\.0003 mm, less than the 0\.02 mm .*; check that the depths are in mm, not",
    ),
    Case(
        "three filters of a tilt",
        BAD_PLAN,
        r"plan\.toml: 'second_tilt_filters': must have fewer entries, at most 2",
        edited(
            "plan.toml",
            "[region]",
            'second_tilt_deg = 30.0\nsecond_tilt_filters = ["560", "600", "630"]\n[region]',
        ),
    ),
    Case(
        "bracket that is brighter than metered",
        BAD_PLAN,
        r"plan\.toml: 'bracket \(entry 1\)': must be at most 1, got 4\.0",
        edited("plan.toml", "bracket = [1.0, 0.25]", "bracket = [4.0, 1.0]"),
    ),
    Case(
        "key in another language",
        BAD_PLAN,
        r"plan\.toml: 'zielhelligkeit': unknown key; .*nown keys are bracket",
        edited("plan.toml", "target_fraction", "zielhelligkeit"),
    ),
    Case(
        "semicolon at the end of a line",
        BAD_PLAN,
        r"plan\.toml: cannot be read as TOML .*; correct the line 'paint_name = \"red\";'",
        edited("plan.toml", 'paint_name = "red"', 'paint_name = "red";'),
    ),
    Case(
        "practice fault without its unit",
        BAD_RIG,
        r"'simulated\.practice_fault': the size of 'stray light' must be a number .* 'stray light, 10 DN/s'",
        edited("rig.toml", "[simulated]", '[simulated]\npractice_fault = "stray light, 10"'),
    ),
    Case(
        "history of no folder",
        "history {tmp}/sessions",
        r"sessions: no such folder; give the folder that holds the session folders of 'finray capture'",
    ),
    Case(
        "folder that is missing beside one that is not",
        "compare {tmp}/nowhere {lab} --out {tmp}/c",
        r"nowhere: no such file or folder; give two records or folders",
    ),
    Case(
        "name that is not ASCII",
        "fit {tmp}/gr\u00fcne.json",
        "gr\u00fcne\\.json: no such file; give the path of a stored",
    ),
    Case(
        "page for its record",
        "fit {lab}/report.html",
        r"report\.html: cannot be read as JSON .*; the file does not begin with \{ or \[",
    ),
    Case(
        "channel of a colour that a sensor lacks",
        "design show {tmp}/sensor.toml",
        r"'lights \(entry 1\)\.channel': must be 'red', 'green', 'blue' or 'white', got 'purple'",
        file(
            "sensor.toml",
            'kind = "sensor"\npreset = "digit"\nname = "x"\n[[lights]]\nchannel = "purple"\ndistance_mm = 10.0\n'
            "depth_mm = 5.0\nazimuth_deg = 0.0\n",
        ),
    ),
    Case(
        "limits with a unit",
        "design optimise {lab}/finger.toml --for softness --within pad.thickness_mm=4mm:8mm",
        r"--within: 'pad\.thickness_mm=4mm:8mm' must be FIELD=LOW:HIGH, such as light\.angle_deg=0:60",
    ),
    Case(
        "squares with a comma",
        "sense scale a.png --pad b.png --squares 7,5 --square-mm 3 --marker-mm 2 --square-u-mm 0.01",
        r"--squares 7,5: must be two whole numbers such as 7x5",
    ),
    Case(
        "number of filters",
        "design filters {lab}/rig.toml --number 0 --paints 0",
        r"design: the number of filters must be 2 to 64 \(--number\), but 0 were requested; 1 are kept, 71",
    ),
    Case(
        "columns of pairs",
        "compare --pairs {tmp}/pairs.csv --out {tmp}/c",
        r"row 1: must name a file in both columns, simulated and captured, but the row has sim = a, cap = b",
        file("pairs.csv", "sim,cap\na,b\n"),
    ),
    Case(
        "semicolons in a study",
        "check gauge-rr {tmp}/study.csv",
        r"error: \S*study\.csv, line 2: an entry is missing; give sample, session and value",
        file("study.csv", "sample,session,value\nA;1;2\n"),
    ),
    Case(
        "folder without its description",
        "import bands {lab}",
        r"lab\S*: bands\.toml, which tells what each image shows, is missing; write it as",
    ),
    Case("not a JSON", "fit {lab}/plan.toml", r"plan\.toml: cannot be read as JSON \(.*\); the file does not"),
    Case(
        "newer record",
        "decide {tmp}/sweep.json",
        rf"sweep\.json: schema_version 9 was written by a newer finray, .* update with {NEW}",
        edited("sweep.json", '"schema_version": 5', '"schema_version": 9'),
    ),
    Case(
        "record without its arrays",
        "compare {lab}/press.json {tmp}/capture.json",
        r"\.npz: is missing, but it contains the arrays of capture\.json; keep the two files together",
        without_array_file,
    ),
    Case(
        "NaN in a record",
        "decide {tmp}/sweep.json",
        r"sweep\.json: cannot be read as JSON \(NaN is not a number; write null for a missing value\)",
        edited("sweep.json", "0.0,", "NaN,"),
    ),
    # simulate
    Case("a design that is not there", "simulate render {tmp}/no.toml", r"no\.toml: no such file; give the path of a"),
    Case(
        "no paint",
        "simulate render {lab}/finger.toml --engine scalar",
        r"the red wall has no paint; give --paint red=FILE and",
    ),
    Case(
        "angles in radians",
        SWEEP + " --angles 0:2.09:0.5",
        r"--angles: 5 angles of the light from 0 to 2 deg span less than 4 deg, .* suggests radians .*--narrow-sweep",
    ),
    Case("only the red paint", SIMULATE, r"the green wall has no paint; give --paint red=FILE and --paint green=FILE"),
    Case(
        "two red paints",
        BOTH + " --paint red={lab}/no.json",
        r"--paint: a colour is given twice; give one file for red",
    ),
    Case(
        "bands as paint",
        SIMULATE + " --paint green={lab}/bands.json",
        r"bands\.json: contains band signals, but a paint cal",
    ),
    Case(
        "mechanics with paints",
        "simulate press {lab}/finger.toml --level c",
        r"finray simulate: error: 'finray simulate press' does not take --level c; 'finray simulate press --help' ",
    ),
    Case(
        "increments of a render",
        BOTH + " --increments 3",
        r"finray simulate: error: 'finray simulate render' does not take --increments 3; .*--help' lists what",
    ),
    Case(
        "indenter that starts inside the finger",
        MECHANICS,
        r"the indenter starts inside the finger, .* check indenter\.file, position_mm, across_mm and rotation_deg",
        # a second body far below, in the base plate
        with_indenter(np.vstack([CUBE, CUBE - [0.0, 14.0, 43.0]]), np.vstack([FACETS, FACETS + 8])),
    ),
    Case(
        "open STL",
        MECHANICS,
        r"body\.stl: the body is not closed, because 3 edges belong to only one triangle .* close the body",
        with_indenter(CUBE, FACETS[1:]),
    ),
    Case(
        "STL in metres",
        MECHANICS,
        r"body\.stl: .* seems to be in metres; export it in mm",
        with_indenter(1e-3 * CUBE, FACETS),
    ),
    Case(
        "no STL",
        MECHANICS,
        r"no\.stl: no such file; give the path of the indenter's STL file \(indenter\.file\)",
        design('[indenter]\nshape = "mesh"\nfile = "no.stl"'),
    ),
    Case(
        "name of a ready-made finger for its file",
        "simulate press flat-70x35",
        r"flat-70x35: no such file; write it with 'finray design init flat-70x35', then give flat-70x35\.toml",
    ),
    Case(
        "no surrogate",
        MECHANICS + " --surrogate {tmp}/none.json",
        r"none\.json: no such file; give the path of a surrogate \(\.json\)",
        design("[indenter]\nradius_mm = 10.0"),
    ),
    Case(
        "a surrogate of a press to a force",
        MECHANICS + " --surrogate {tmp}/none.json --force 2",
        r"--surrogate computes only a press to a given depth .*, without friction; leave out --surrogate, or --force",
        design("[indenter]\nradius_mm = 10.0"),
    ),
    Case(
        "largest error of no surrogate",
        MECHANICS + " --largest-error 0.1",
        r"--largest-error applies only to a surrogate; add --surrogate FILE, or leave --largest-error out",
        design("[indenter]\nradius_mm = 10.0"),
    ),
    Case(
        "too few presses for teaching",
        "simulate teach {tmp}/finger.toml --presses 3",
        r"finger\.toml: 3 presses are too few; give at least 20",
        design("[indenter]\nradius_mm = 10.0"),
    ),
    Case(
        "contact of CalculiX",
        MECHANICS + " --contact barrier --engine calculix",
        r"--contact: CalculiX has its own contact method; leave out --contact or --engine calculix",
        design(""),
    ),
    Case(
        "unstable rubber",
        MECHANICS,
        r"mechanics\.skeleton: .*alpha = \(1\.6663, -7\.136\) is unstable \(Drucker\) under uniaxial load at a stretch",
        design("[mechanics.skeleton]\nmu_mpa = [6.279, -1.639]"),
    ),
    Case(
        "skeleton in GPa",
        MECHANICS,
        r"'mechanics\.skeleton': mu_mpa: the initial shear modulus .* of 0\.007918 MPa .* in GPa, so write 7\.918",
        design("[mechanics.skeleton]\nmu_mpa = [0.006279, 0.001639]"),
    ),
    Case(
        "cuboid in micrometres",
        MECHANICS,
        r"'indenter\.size_mm \(entry 1\)' \(in mm\): must be at most 1000, got 50000\.0; correct it, and give it in mm",
        design('[indenter]\nshape = "cuboid"\nsize_mm = [50000.0, 15.0, 15.0]'),
    ),
    Case(
        "gel in kPa",
        MECHANICS,
        r"finger\.toml: 'mechanics\.gel\.c10_mpa' \(in MPa\): .* looks like a number in kPa, so write 0\.1333",
        design("[mechanics.gel]\nc10_mpa = 133.3"),
    ),
    Case(
        "pad in metres",
        MECHANICS,
        r"pad\.thickness_mm: 0\.006 mm is outside .* looks like a number in metres, so write 6",
        design("[pad]\nthickness_mm = 0.006\n[indenter]\ndepth_mm = 0.02"),
    ),
    Case(
        "film that no deck can hold",
        "export deck {tmp}/finger.toml --dialect calculix --out {tmp}/f.inp",
        r"finger\.toml: pad\.film\.thickness_mm: 100 mm is outside",
        design("[pad]\nfilm.thickness_mm = 100.0\n"),
    ),
    Case(
        "film that no press can hold",
        MECHANICS,
        r"finger\.toml: pad\.film\.thickness_mm: 100 mm is outside",
        design("[pad]\nfilm.thickness_mm = 100.0\n"),
    ),
    Case(
        "captures of parts that do not fit",
        "export capture-request {tmp}/finger.toml --out {tmp}/ask.md",
        r"finger\.toml: pad\.film\.thickness_mm: 100 mm is outside",
        design("[pad]\nfilm.thickness_mm = 100.0\n"),
    ),
    Case(
        "indenter's file is missing",
        MECHANICS,
        r"finger\.toml: .*no\.stl: no such file; give the path of the indenter's STL file",
        design('[indenter]\nshape = "mesh"\nfile = "no.stl"\n'),
    ),
    Case(
        "indenter's radius in metres",
        MECHANICS,
        r"finger\.toml: indenter\.radius_mm: 0\.01 mm is outside .* in metres, so write 10",
        design("[indenter]\nradius_mm = 0.01\n"),
    ),
    Case(
        "pad's length in metres",
        MECHANICS,
        r"must lie on the pad \(0 to 0\.07 mm\); pad\.length_mm looks like a number in metres, so write 70",
        design("[pad]\nlength_mm = 0.07\n"),
    ),
    Case(
        "depth in metres",
        MECHANICS,
        r"depth_mm = 0\.0015 mm is less than .* looks like a number in metres, so write 1\.5",
        design("[indenter]\ndepth_mm = 0.0015\n"),
    ),
    Case(
        "9DTact sensor that predicts itself",
        "import 9dtact {tmp}/s --predict-from {tmp}/./s",
        r"is the same sensor, .*; give the folder of another sensor",
        design(""),
    ),
    Case(
        "finger without paints as a Taxim sensor",
        "export taxim {tmp}/finger.toml --out {tmp}/t",
        r"finger\.toml: is the design of a finger, .* add --paint red=",
        design("[pad]\nlength_mm = 60.0\n"),
    ),
    Case(
        "film in metres",
        MECHANICS,
        r"pad\.film\.thickness_mm: 0\.0001 mm is outside .* looks like a number in metres, so write 0\.1",
        design("[pad.film]\nthickness_mm = 0.0001"),
    ),
    Case(
        "indenter in metres",
        MECHANICS,
        r"indenter\.radius_mm: 0\.01 mm is outside .* looks like a number in metres, so write 10",
        design("[indenter]\nradius_mm = 0.01"),
    ),
    Case(
        "pad wider than the fin",
        MECHANICS,
        r"finger\.toml: skeleton\.width_mm = 30 mm is too narrow; .* the pad \(pad\.width_mm = 35 mm\) and a rib",
        design("[skeleton]\nwidth_mm = 30.0"),
    ),
    Case(
        "ribs that overlap",
        MECHANICS,
        r"ribs? .* overlap or nearly touch .* change skeleton\.rib_count = 40, rib_spacing_mm",
        design("[skeleton]\nrib_count = 40\nrib_thickness_mm = 2.0"),
    ),
    Case(
        "objectives of a sweep for a render",
        BOTH + " --objectives all",
        r"finray simulate: error: 'finray simulate render' does not take --objectives all; ",
    ),
    Case(
        "objectives of sensing by the scalar renderer",
        SWEEP + " --angles 0:90:30 --engine scalar --objectives all",
        r"need a compiled variant of Mitsuba, .*; leave out --engine scalar",
    ),
    Case(
        "sweep of the paper's emitter",
        SWEEP + " --angles 0:90:10 --level a",
        r"finray simulate: error: 'finray simulate sweep' does not take --level a; ",
    ),
    Case(
        "unknown key in a finger",
        BAD_FINGER,
        r"finger\.toml: 'camera\.hight_px': unknown key; did you mean 'height_px'\?",
        edited("finger.toml", "height_px", "hight_px"),
    ),
    Case(
        "angle out of range",
        BAD_FINGER,
        r"finger\.toml: 'light\.angle_deg' \(in deg\): must be at most 180, got 500; correct it, and give it in deg",
        edited("finger.toml", "[camera]", "[light]\nangle_deg = 500\n[camera]"),
    ),
    Case(
        "indenter through the pad",
        BAD_FINGER,
        r"indenter\.depth_mm = 6\.5 mm goes through the pad, but must be below .* 6\.0 mm",
        edited("finger.toml", "[camera]", "[indenter]\ndepth_mm = 6.5\n[camera]"),
    ),
    Case("place off the pad", SWEEP + " --angles 0:90:30 --positions 8,90", r"90 mm is not on the pad; .* below 70 mm"),
    Case(
        "places of one press",
        SWEEP + " --angles 0:90:30 --positions 8,20 --surfaces {lab}/finger.toml",
        r"--positions works only for presses by a formula, but --surfaces is a press at one place; sweep each",
    ),
    # compare and decide
    Case(
        "images of different size",
        "compare {lab}/press.json {lab}/cut-capture.json",
        r"press\.json and \S+cut-capture\.json: strip has 80 x 60 px, .* has 80 x 40 px; simulate with the camera of",
    ),
    Case(
        "black render",
        "compare {lab}/black-press.json {lab}/capture.json",
        r"black-press\.json and \S+capture\.json: no exposure factor fits, because .* is black over the region; check",
    ),
    Case(
        "compare exchanged",
        "compare {lab}/capture.json {lab}/press.json",
        r"capture\.json: contains a tactile capture, but a simu",
    ),
    Case(
        "three angles",
        "decide {lab}/short-sweep.json",
        r"short-sweep\.json: The sweep has only 3 angles, but at least 4 are need",
    ),
    Case(
        "report on encoded values",
        "decide {lab}/sweep.json --photometric-error {lab}/encoded-report.json",
        r"sweep\.json and \S+encoded-report\.json: .*contains no brightness error, .* on both sides; render the press",
    ),
    Case(
        "one capture twice",
        "decide {lab}/sweep.json --photometric-error {lab}/report.json --photometric-error {lab}/report.json",
        r"two reports are on the capture 'capture of the strip', which would count twice\. Give one report",
    ),
    Case(
        "one touch twice",
        "decide {lab}/sweep.json {lab}/sweep.json",
        r"two sweeps belong to the same touch \(position_mm = 35 mm\), which would count twice",
    ),
    Case(
        "weights that do not fit",
        "decide {lab}/sweep.json --weights 1,2",
        r"weights \[1\.0, 2\.0\] do not fit one sweep; give one number above 0 for each sweep",
    ),
    # import and demo
    Case(
        "no 9DTact folder",
        "import 9dtact {lab}/session",
        r"rectify_crop_ref\.png: no such file\. Give the folder of one",
    ),
    Case(
        "no material",
        "demo --engine scalar --red {tmp}/no.csv --out {tmp}/d",
        r"no\.csv: no such file; give the path of",
    ),
    Case(
        "no green material",
        "demo --engine scalar --green {tmp}/no.csv --out {tmp}/d",
        r"no\.csv: no such file; give the",
    ),
    Case(
        "camera response as material",
        "demo --engine scalar --red {tmp}/camera.csv --out {tmp}/demo",
        r"camera\.csv: the first column is 'wavelength_nm', but a re-radiation matrix needs 'emission_nm'",
        curve("380,1,2,3\n720,1,2,3\n"),
    ),
    Case(
        "material with unsorted wavelengths",
        "demo --engine scalar --red {tmp}/ink.csv --out {tmp}/demo",
        r"ink\.csv: wavelengths must increase from row to row: 450 nm follows 460 nm; sort the rows",
        file("ink.csv", MATRIX + "460,0.1,0.1\n450,0.1,0\n470,0,0\n"),
    ),
    Case(
        "NaN in a material",
        "demo --engine scalar --red {tmp}/ink.csv --out {tmp}/demo",
        r"ink\.csv, line 3: 'nan' is not a finite number; correct or remove the row, or measure it again",
        file("ink.csv", MATRIX + "450,0.1,0\n460,nan,0.1\n470,0,0\n"),
    ),
    Case(
        "material with uneven steps",
        "demo --engine scalar --red {tmp}/ink.csv --out {tmp}/demo",
        r"ink\.csv: emission_nm steps range from 10 to 30 nm, .* give the matrix on evenly spaced",
        file("ink.csv", MATRIX + "450,0.1,0\n460,0.1,0.1\n490,0,0\n"),
    ),
    Case(
        "sensor that ends at 420 nm",
        "demo --engine scalar --sensor {tmp}/camera.csv --out {tmp}/demo",
        r"camera\.csv: curve 'red' covers only 380 to 420 nm, and .* \(at most 20 % is allowed\); give a curve that",
        curve("380,1,2,3\n420,1,2,3\n"),
    ),
    Case(
        "demo into a full folder",
        "demo --engine scalar --out {lab}",
        r"exists already and is not empty; choose another",
    ),
    # --out
    Case(
        "out is a session", CAPTURE + " --out {lab}/session", r"session: exists already and is not overwritten; choose"
    ),
    Case(
        "out is a record", "fit {lab}/bands.json --out {lab}/sweep.json", r"sweep\.json: exists already and is not over"
    ),
    Case(
        "out below a file",
        CAPTURE + " --out {lab}/plan.toml/s",
        r"plan\.toml/s: cannot be written, because .* not a folder",
    ),
    Case(
        "out where nothing can be", CAPTURE + " --out /proc/session", r"/proc/session: No such file .*; check the path"
    ),
    Case(
        "record where nothing can be",
        "fit {lab}/bands.json --out /proc/x.paint.json",
        r"error: /proc/x\.paint\.json: No such file .*; check the path",
    ),
    Case(
        "design where nothing can be",
        "design init --out /proc/x.toml",
        r"error: /proc/x\.toml: No such file .*; check the path",
    ),
    Case(
        "name that is too long",
        "capture {lab}/plan.toml --rig {lab}/rig.toml --out " + 300 * "a",
        r"File name too long; give a shorter name",
    ),
    Case(
        "a second place to write to",
        "fit {lab}/bands.json --out {tmp}/paint.json --out {lab}/sweep.json",
        r"lab\S*/sweep\.json: exists already and is not overwritten",
    ),
    Case(
        "empty record",
        "fit {tmp}/empty.json",
        r"cannot be read as JSON .*; the file is empty; give the path of a stored record",
        file("empty.json", ""),
    ),
    Case(
        "empty study of a gauge",
        "check gauge-rr {tmp}/study.csv",
        r"must name the columns sample, session, and paint or value .* its columns are missing",
        file("study.csv", ""),
    ),
    Case(
        "text with the name of an archive",
        "import captures {tmp}/set.zip --recipe fots-gelsight",
        r"set\.zip: cannot be read as a zip archive .*; copy it again",
        file("set.zip", "no archive"),
    ),
    Case(
        "options of a recipe without one",
        "import captures {lab} --circles none.csv --out {tmp}/recipe.toml",
        r"--circles, --ball-diameter-mm, --mm-per-px and --predict-from work only with --recipe NAME\|FILE; add it",
    ),
    Case(
        "paints of a study without images",
        "study run {tmp}/study.toml --paint red=none.json --paint green=none.json",
        r"study\.toml: the plan renders no images \(measure\.images = false\), so --paint has no effect; leave it out",
        file("study.toml", STUDY),
    ),
    Case(
        "paints as given of a study without images",
        "study run {tmp}/study.toml --paints-as-given",
        r"study\.toml: the plan renders no images .*, so --paints-as-given has no effect; leave it out",
        file("study.toml", STUDY),
    ),
    Case(
        "parts of a classic sensor",
        "design export digit",
        r"digit: is a classic sensor, but a finger is needed",
    ),
    Case("folder without pictures of a board", "sense scale {lab}", r": contains no tactile session \(session\.json"),
    Case(
        "finger for a rig",
        "rig show {tmp}/finger.toml",
        r"contains the design of a finger or sensor, but a rig file is needed; give the path of",
        design("[pad]\nthickness_mm = 5.0"),
    ),
    Case(
        "captures of a folder that is not there",
        "bench tactile {lab}/nosuch",
        r"nosuch: no such folder; give the folder that 'finray import captures' wrote",
    ),
)

USAGE = (
    Case(
        "misspelt verb",
        "fits {lab}/bands.json",
        r"invalid choice: 'fits' .*; did you mean 'fit'\? 'finray --help' explains",
    ),
    Case(
        "history with too short a reference",
        "history {lab} --reference 5",
        r"argument --reference: '5' must be a whole number from 6 to \d+",
    ),
    Case(
        "history with too many false alarms",
        "history {lab} --false-alarms 1",
        r"argument --false-alarms: '1' must be a share \(0.01 is 1 %\) of 0.0001 to 0.2",
    ),
    Case("capital letter", "Fit {lab}/bands.json", r"invalid choice: 'Fit' .*; did you mean 'fit'\?"),
    Case(
        "misspelt job",
        "simulate rneder f.toml",
        r"invalid choice: 'rneder' .*; did you mean 'render'\? 'finray simulate",
    ),
    Case(
        "misspelt choice", "fit {lab}/bands.json --family skewt", r"--family: invalid choice: .*; did you mean 'skew_t'"
    ),
    Case("no such verb", "calibrate", r"invalid choice: 'calibrate' \(choose from .*'capture', 'radiometry', 'fit'"),
    Case(
        "paint of another colour",
        "simulate render {lab}/finger.toml --paint blue=x",
        r"'blue=x' must be red=FILE or green=FILE",
    ),
    Case(
        "paint without file", "simulate render {lab}/finger.toml --paint red", r"'red' must be red=FILE or green=FILE"
    ),
    Case("angles in words", SWEEP + " --angles all", r"'all' must be FIRST:LAST:STEP in deg, for example 0:120:10"),
    Case("angles backwards", SWEEP + " --angles 120:0:10", r"'120:0:10': must have -90 <= FIRST < LAST <= 180 deg"),
    Case("angles too near", SWEEP + " --angles 0:120:1e-9", r"must have .* and a STEP from 0\.5 deg to LAST - FIRST"),
    Case("angles that are NaN", SWEEP + " --angles nan:nan:nan", r"'nan:nan:nan': must have -90 <= FIRST < LAST"),
    Case(
        "places in words",
        SWEEP + " --angles 0:90:30 --positions all",
        r"'all' must be FIRST:LAST:STEP in mm with a STEP",
    ),
    Case("places too near", SWEEP + " --angles 0:90:30 --positions 8,8.01", r"or places at least 0\.1 mm apart"),
    Case("places backwards", SWEEP + " --angles 0:90:30 --positions 64:8:4", r"'64:8:4' must be FIRST:LAST:STEP in mm"),
    Case("weights in words", "decide {lab}/sweep.json --weights often", r"'often' must be numbers above 0 with commas"),
    Case("no samples", BOTH + " --samples 0", "'0' must be an even whole number from 2 to 1000000"),
    Case(
        "negative seed", "fit {lab}/bands.json --seed -1", r"argument --seed: -1 is out of range; give 0 to 2\^63 - 1"
    ),
    Case("seed in words", "decide {lab}/sweep.json --seed one", r"argument --seed: 'one' is not a whole number"),
    Case("no seed", "decide {lab}/sweep.json --seed", r"--seed: a value must follow it; .*; 'finray decide --help'"),
    Case(
        "a weight below 0", "decide {lab}/sweep.json --weights -1,2", r"begins with '-', type --weights=-VALUE; 'finray"
    ),
    Case("angles below 0", SWEEP + " --angles -60:100:10", r"begins with '-', type --angles=-60"),
    Case("unknown format", "import taxidermy {lab}", r"invalid choice: 'taxidermy' \(choose from '?captures"),
)
