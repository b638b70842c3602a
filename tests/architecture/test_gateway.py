"""No reader opens a file around the gateway of `data_schemas.storage._foreign_files`."""

import ast
import re
from collections.abc import Iterator

from tests.architecture.test_conventions import MODULES, ROOT

# What opens a file for reading, by its last name; `Image.open`, `path.open` and `open` are all "open".
READERS = {
    "open", "fdopen", "read_text", "read_bytes", "load", "imread", "fromfile", "memmap", "loadtxt", "genfromtxt",
    "TiffFile", "ZipFile", "FileStorage", "load_file", "Bitmap", "InputFile", "File", "parse", "open_dataset",
    "imdecode", "loads",
}  # fmt: skip
GATEWAY = {"read_bytes", "read_text", "parse"}
"""Imported by name from the gateway; `parse` is the line reader of the Arduino."""
# (module, call) -> why it may: it writes, reads what this package made itself, or is the gateway or its child.
ALLOWED = {
    ("data_schemas/storage/_foreign_files.py", "os.open"): "the gateway",
    ("data_schemas/storage/_foreign_files.py", "os.fdopen"): "the gateway",
    ("data_schemas/storage/_foreign_files.py", "json.loads"): "the gateway",
    ("data_schemas/storage/_foreign_files.py", "tomllib.loads"): "the gateway",
    ("data_schemas/storage/_array_files.py", "zipfile.ZipFile"): "bytes of the gateway",
    ("data_schemas/storage/_array_files.py", "archive.open"): "bytes of the gateway",
    ("data_schemas/storage/_zip_archives.py", "zipfile.ZipFile"): "a file that the gateway opened",
    ("data_schemas/storage/_zip_archives.py", "self._archive.open"): "the same",
    ("data_schemas/storage/_array_files.py", "tifffile.TiffFile"): "bytes of the gateway",
    ("rigs/cameras/_image_files.py", "tifffile.TiffFile"): "bytes of the gateway",
    ("rigs/cameras/_image_files.py", "rawpy.imread"): "bytes of the gateway, in a limited child",
    ("sim/surface_meshes/_imprint.py", "cv2.imdecode"): "bytes of the gateway, in its child",
    ("rigs/cameras/_image_files.py", "cv2.imdecode"): "bytes of the gateway, or a camera's stream of limited size",
    ("sim/optics/_calibrated_camera.py", "cv2.FileStorage"): "bytes of the gateway, in a limited child",
    ("finray_calib/exchange/_paint_reradiation.py", "_open_exr().File"): "bytes of the gateway, in a limited child",
    **dict.fromkeys(
        (
            ("data_schemas/_lazy_exports.py", "Path(file).read_bytes"),
            ("data_schemas/_lazy_exports.py", "ast.parse"),
        ),
        "the source of a package's own front door",
    ),
    **dict.fromkeys(
        (
            ("finray_calib/exchange/_paint_reradiation.py", "file.read_bytes"),
            ("finray_calib/exchange/_paint_formats.py", "file.read_bytes"),
            ("finray_calib/exchange/_record_formats.py", "file.read_bytes"),
        ),
        "what a library has just written into a temporary folder",
    ),
    **dict.fromkeys(
        (
            ("finray_calib/exchange/_paint_reradiation.py", "open_exr.File"),
            ("sim/optics/_renderer.py", "mitsuba.Bitmap"),
            ("data_schemas/storage/_product_set.py", "os.open"),
            ("data_schemas/storage/_product_set.py", "json.loads"),
            ("data_schemas/storage/_whole_files.py", "os.open"),
            ("rigs/capture/_journal.py", "os.open"),
        ),
        "writes, syncs or locks, and reads what a dead writer of finray left",
    ),
    **dict.fromkeys(
        (
            ("data_schemas/storage/_child_process.py", "Path('/proc/self/statm').read_text"),
            ("data_schemas/storage/_child_process.py", "Path(f'/proc/{process}/status').read_text"),
            ("data_schemas/storage/_child_process.py", "Path('/proc/vmstat').read_text"),
            ("data_schemas/_provenance.py", "Path('/proc/cpuinfo').read_text"),
            ("data_schemas/storage/_child_process.py", "Path('/proc/meminfo').read_text"),
            ("data_schemas/storage/_child_process.py", "(folder / 'memory.max').read_text"),
            ("data_schemas/storage/_child_process.py", "(folder / 'memory.current').read_text"),
            ("data_schemas/storage/_child_process.py", "(folder / 'memory.stat').read_text"),
            ("rigs/light_guard/watch.py", "os.open"),
            ("finray_calib/cli/_output.py", "os.open"),
            ("finray_calib/cli/main.py", "os.open"),
            ("finray_calib/cli/main.py", "os.fdopen"),
        ),
        "the kernel's own",
    ),
    **dict.fromkeys(
        (
            ("data_schemas/storage/_child_process.py", "json.loads"),
            ("data_schemas/storage/_child_process.py", "os.fdopen"),
            ("data_schemas/storage/_child_process.py", "os.open"),
            ("rigs/light_guard/_reconnecting_light.py", "json.loads"),
        ),
        "pipes and logs between processes of finray",
    ),
    **dict.fromkeys(
        (
            ("rigs/transports/_alpaca_client.py", "json.loads"),
            ("rigs/transports/_alpaca_client.py", "json.loads"),
        ),
        "an answer of a device, whose length is limited",
    ),
    **dict.fromkeys(
        (
            ("finray_calib/fit/_measured_spectra.py", "PROTOTYPES_FILE.read_text"),
            ("finray_calib/fit/_measured_spectra.py", "json.loads"),
        ),
        "numbers that this package ships",
    ),
    ("finray_calib/spectra/family_kernels.py", "path.read_bytes"): "sources of this package, as the key of a cache",
    **dict.fromkeys(
        (
            ("data_schemas/_lazy_exports.py", "Path(file).read_bytes"),
            ("data_schemas/_lazy_exports.py", "ast.parse"),
        ),
        "the list of exports in a face of this package",
    ),
    **dict.fromkeys(
        (
            ("data_schemas/_plug_ins.py", "plug_in.load"),
            ("finray_calib/compare/_candidate_errors.py", "plug_in.load"),
            ("finray_calib/demo/_machine_checks.py", "find_plug_in(part.kind, part.name).load"),
            ("finray_calib/exchange/_record_formats.py", "plug_in.load"),
            ("rigs/_drivers.py", "driver.plug_in.load"),
            ("sim/mechanics/_indenters.py", "plug_in.load"),
            ("sim/mechanics/_materials.py", "plug_in.load"),
        ),
        "a module of another package, which its entry point names",
    ),
    (
        "finray_calib/reports/studies/_design_study_page.py",
        "cv2.imdecode",
    ): "the picture that it has just drawn",
}
# Devices, too, are opened.
DEVICES = re.compile(r"(camera|light|self|self\._guard|self\._light|CameraWatch\(.*\))\.open")


def calls() -> Iterator[tuple[str, str, ast.Call]]:
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                yield str(path.relative_to(ROOT)), ast.unparse(node.func), node


def test_every_file_is_read_through_the_gateway():
    around = {
        (module, called)
        for module, called, node in calls()
        if called.rpartition(".")[2] in READERS
        and not _writes(node)
        and called not in GATEWAY
        and not DEVICES.fullmatch(called)
    }
    assert sorted(around - ALLOWED.keys()) == [], (
        "read through data_schemas.storage._foreign_files, or say here why not"
    )
    assert sorted(ALLOWED.keys() - around) == [], "stands here without need"


def _writes(call: ast.Call) -> bool:
    """Whether a call of open says a mode that only writes."""
    words = [a.value for a in (*call.args, *(k.value for k in call.keywords)) if isinstance(a, ast.Constant)]
    return any(isinstance(word, str) and word[:1] in "wxa" and len(word) <= 3 for word in words)
