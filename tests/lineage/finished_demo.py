"""A small tree of files as a finished demo leaves it: sessions really captured, later products made up, all bound."""

import json
from pathlib import Path

import numpy as np

from data_schemas import BandSignals, FingerSurfaces, PaintCalibration, Record, provenance
from data_schemas.storage import read_record, sha256_of, write_bytes, write_manifest, write_record
from rigs import paint_plan, simulated_rig, write_plan, write_rig
from rigs.capture import SessionRequest, capture_paint_session
from tests.command_line.records import capture_of, press, sweep
from tests.schemas.freeze import example_of

COLOURS = ("red", "green")
DECISION = "light-angle-decision.json"
COMMAND = "finray demo --out finray-demo"


def finish_demo(out: Path) -> Path:
    """Write the tree into a new folder and return it."""
    write_bytes(out / "demo.json", b'{"seed": 1}\n')
    for number, colour in enumerate(COLOURS):
        _paint(out, colour, seed=1 + number)
    paints = [f"{colour}/paint.json" for colour in COLOURS]
    surfaces = "pressed-finger.surfaces.json"
    _store(out, surfaces, _surfaces(), [])
    _store(out, "pressed-finger.mechanics.json", _example("PressMechanics"), [])
    linear = press()
    _store(out, "press.json", linear, [surfaces, *paints])
    _store(out, "sweep.json", sweep(), [surfaces, *paints])
    _store(out, "true-sweep.json", sweep(), [surfaces])
    _store(out, "tactile-capture.json", capture_of(linear, 50.0), [surfaces])
    _store(out, "photometric-error.json", _example("PhotometricErrorReport"), ["press.json", "tactile-capture.json"])
    _store(out, DECISION, _example("LightAngleDecision"), ["sweep.json", "photometric-error.json"])
    write_bytes(out / "summary.json", (json.dumps({"angle_deg": 35.0}) + "\n").encode())
    write_bytes(out / "report.html", b"<!doctype html><title>A demo</title><p>The light at 35 deg.</p>\n")
    write_manifest(out)
    return out


def _paint(out: Path, colour: str, seed: int) -> None:
    """Capture a small session; store bands and paint after it."""
    rig = simulated_rig(colour, seed=seed, width_px=96, height_px=80)
    plan = paint_plan(f"{colour} paint", rig.camera)
    folder = out / colour
    written = (write_rig(rig, folder / "rig.toml"), write_plan(plan, folder / "plan.toml"))
    sources = {f"{colour}/{path.name}": sha256_of(path) for path in written}
    capture_paint_session(rig, plan, SessionRequest(folder / "session", COMMAND, rig_folder=folder, sources=sources))
    _store(out, f"{colour}/bands.json", _example(BandSignals.__name__), [f"{colour}/session/session.json"])
    _store(out, f"{colour}/paint.json", _larger(_example(PaintCalibration.__name__)), [f"{colour}/bands.json"])


def _example(kind: str) -> Record:
    """Return the frozen example of a kind."""
    from data_schemas.json_schemas import STORED

    record_type = next(t for t in STORED if t.__name__ == kind)
    return read_record(example_of(record_type, record_type.schema_version), record_type)


def _larger(paint: Record) -> Record:
    """Return a paint with enough draws for an array file."""
    draws = np.random.default_rng(0).standard_normal((200, len(paint.sampled)))  # type: ignore[attr-defined]
    return paint.model_copy(update={"draws": draws})


def _surfaces() -> FingerSurfaces:
    """Return a coat of many equal triangles."""
    count = 200
    vertices = np.random.default_rng(0).uniform(size=(3 * count, 3))
    return FingerSurfaces(
        name="finger",
        label="pressed",
        push_mm=4.0,
        parts=("coat",),
        vertex_counts=np.array([3 * count]),
        triangle_counts=np.array([count]),
        vertices_mm=vertices,
        rest_vertices_mm=vertices,
        uv=vertices[:, :2],
        triangles=np.arange(3 * count).reshape(-1, 3),
        contact_distance=np.full(3 * count, np.nan),
    )


def _store(out: Path, name: str, record: Record, inputs: list[str]) -> None:
    """Store a record with the inputs that it was made from."""
    write_record(record, out / name, provenance(COMMAND, {i: sha256_of(out / i) for i in inputs}, 1))
