"""The six stages of the demo, each from stored records to stored records.

A stage imports what it needs when it runs: each group of stages has a process of its own, which loads its own packages.
"""

import hashlib
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from data_schemas import (
    BandSignals,
    CaptureSession,
    FingerDesign,
    FingerSurfaces,
    FitError,
    LightAngleDecision,
    LightAngleSweep,
    PaintCalibration,
    PaintWithoutEmission,
    PhotometricErrorReport,
    Preset,
    PressMechanics,
    Record,
    RigFile,
    SimulatedPress,
    TactileCapture,
    digest_of_input,
    provenance,
)
from data_schemas.storage import progress_sender, read_bytes, read_record, write_bytes, write_record
from sim.optics import RendererChoice, open_renderer

if TYPE_CHECKING:
    from rigs.simulated import BenchTruth
    from sim.experiments import PaintedFinger
    from sim.optics import Level, PaintOptics
    from sim.surface_meshes import FingerShape

COLOURS = ("red", "green")
ANGLES_DEG = tuple(float(a) for a in range(0, 121, 10))
SWEEP_REPEATS, TRUE_SWEEP_REPEATS = 6, 3
MESH: Preset = "coarse"
PUSH_MM, PUSH_INCREMENTS = 4.0, 2
TWIN_SEED = 1000
PRESS = {"a": "press-level-a.json", "b": "press.json"}
SURFACES, MECHANICS = "pressed-finger.surfaces.json", "pressed-finger.mechanics.json"
CAPTURE, SWEEP, TRUE_SWEEP = "tactile-capture.json", "sweep.json", "true-sweep.json"
#: Beside the place of the press, where the finger is touched too; pressed there by a formula.
OTHER_PLACES_MM = (8.0, 22.0, 50.0, 64.0)
OTHER_SWEEPS = tuple(f"sweep-{place:02.0f}mm.json" for place in OTHER_PLACES_MM)
OTHER_TRUE_SWEEPS = tuple(f"true-{name}" for name in OTHER_SWEEPS)
REPORT = {"a": "photometric-error-level-a.json", "b": "photometric-error.json"}
DECISION = "light-angle-decision.json"
SUMMARY, REPORT_PAGE, LOGS = "summary.json", "report.html", "logs"
WITH_PROGRESS = frozenset({"capture", "press", "simulate", "sweep", "other_sweeps", "true_sweeps", "twin"})
Progress = Callable[[int, int, str], None]
R = TypeVar("R", bound=Record)


@dataclass(frozen=True, slots=True)
class RenderEffort:
    """Paths per pixel of the simulation and of the digital twin, and per probe of the sweep."""

    samples_per_pixel: int
    twin_samples_per_pixel: int
    probe_samples: int


COMPILED_EFFORT = RenderEffort(samples_per_pixel=64, twin_samples_per_pixel=96, probe_samples=4000)
# The scalar renderer is some six times slower on the image and calls Python for every probe.
SCALAR_EFFORT = RenderEffort(samples_per_pixel=40, twin_samples_per_pixel=80, probe_samples=2000)


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """Materials, renderer and seed of a demo.

    Attributes
    ----------
    out
        Folder that receives everything.
    materials
        Colour -> CSV file of a measured re-radiation matrix; a simulated paint of the paper's family where left out.
    sensor
        CSV file of a measured camera response; the assumed one when None.
    seed
        Seed of the bench, the fits, the renders and the decision.
    command
        Command line for the provenance.
    effort
        Paths of the renders.
    """

    out: Path
    materials: Mapping[str, Path]
    sensor: Path | None
    seed: int
    command: str
    effort: RenderEffort = COMPILED_EFFORT


class Demo:
    """Run the stages in order; every product is stored and the next stage reads it back from its file."""

    def __init__(self, settings: DemoSettings, engine: RendererChoice) -> None:
        self.settings = settings
        self.engine = engine

    @cached_property
    def renderer(self) -> ModuleType:
        """Return the renderer, which is opened when the first stage asks for it."""
        return open_renderer(self.engine)

    def path(self, name: str) -> Path:
        """Return the path of a product."""
        return self.settings.out / name

    def rig(self, colour: str) -> RigFile:
        """Return the simulated rig with the sample of one colour."""
        from rigs import simulated_rig

        material = self.settings.materials.get(colour)
        sensor = None if self.settings.sensor is None else str(self.settings.sensor.resolve())
        sample = colour if material is None else str(material.resolve())
        return simulated_rig(sample, sensor, seed=self.settings.seed + COLOURS.index(colour))

    def capture(self, colour: str, progress: Progress) -> CaptureSession:
        """Capture a paint session on the simulated rig; one that was interrupted begins again, for the same noise."""
        from rigs import paint_plan, plan_toml, rig_toml
        from rigs.capture import SessionRequest, capture_paint_session

        rig, folder = self.rig(colour), self.path(colour)
        plan = paint_plan(f"{colour} paint", rig.camera)
        texts = {"rig.toml": rig_toml(rig).encode(), "plan.toml": plan_toml(plan).encode()}
        for name, text in texts.items():
            _write_once(folder / name, text)
        if (folder / "session").is_dir():
            shutil.rmtree(folder / "session")
        sources = {f"{colour}/{name}": hashlib.sha256(text).hexdigest() for name, text in texts.items()}
        return capture_paint_session(
            rig,
            plan,
            SessionRequest(
                folder / "session", self.settings.command, rig_folder=folder, progress=progress, sources=sources
            ),
        )

    def radiometry(self, colour: str) -> BandSignals:
        """Reduce the stored session to band signals."""
        from finray_calib.radiometry import band_signals
        from rigs.capture import read_frame_of, read_session

        folder = self.path(colour) / "session"
        bands = band_signals(read_session(folder), lambda frame: read_frame_of(folder, frame))
        return self._store(bands, f"{colour}/bands.json", [f"{colour}/session/session.json"])

    def fit(self, colour: str) -> PaintCalibration:
        """Fit the emission spectrum to the stored band signals, with emcee as the independent check."""
        from finray_calib.fit import FitOptions, calibrate_paint

        bands = read_record(self.path(f"{colour}/bands.json"), BandSignals)
        paint = calibrate_paint(bands, self.settings.seed, FitOptions(check_by_emcee=True))
        if isinstance(paint, PaintWithoutEmission):
            raise FitError(
                f"the {colour} sample of the demo ({paint.paint_name}) shows {paint.detection.statement}, so "
                "it emits no light for the finger; give the matrix of a fluorescent material"
            )
        return self._store(paint, f"{colour}/paint.json", [f"{colour}/bands.json"])

    def truth(self, colour: str) -> "BenchTruth":
        """Return what the bench hid; it enters the digital twin and the report, never a stage."""
        from rigs.simulated import bench_truth

        return bench_truth(self.rig(colour), self.path(colour))

    def calibrations(self) -> dict[str, PaintCalibration]:
        """Read both stored paint calibrations."""
        return {colour: read_record(self.path(f"{colour}/paint.json"), PaintCalibration) for colour in COLOURS}

    def design(self) -> FingerDesign:
        """Return the finger of the demo: 70 x 35 mm pad, 20 mm cylinder, the sensor under test in its camera."""
        default = FingerDesign()
        design = default.model_copy(update={"indenter": default.indenter.model_copy(update={"depth_mm": PUSH_MM})})
        if self.settings.sensor is None:
            return design
        camera = design.camera.model_copy(update={"response": str(self.settings.sensor.resolve())})
        return design.model_copy(update={"camera": camera})

    def design_at(self, position_mm: float) -> FingerDesign:
        """Return the finger of the demo, touched elsewhere and as deep as a formula presses it by default."""
        touched = FingerDesign().indenter.model_copy(update={"position_mm": position_mm})
        return self.design().model_copy(update={"indenter": touched})

    def press(self, progress: Progress) -> tuple[PressMechanics, FingerSurfaces]:
        """Press the finger by finite elements; everything rendered afterwards has its shape."""
        from finray_calib.spectra import machine_threads
        from sim.experiments import press_records
        from sim.mechanics import PressSettings, press_finger

        design = self.design()
        pressed = press_finger(design, PressSettings(MESH, PUSH_INCREMENTS, machine_threads()), progress=progress)
        mechanics, surfaces = press_records(design, pressed, MESH)
        return self._store(mechanics, MECHANICS, []), self._store(surfaces, SURFACES, [])

    def shapes(self) -> "tuple[FingerShape, FingerShape]":
        """Return the stored shapes of the finger, without and with contact."""
        from sim.surface_meshes import restore_shapes

        return restore_shapes(read_record(self.path(SURFACES), FingerSurfaces))

    def simulate(self, progress: Progress, level: "Level" = "b") -> SimulatedPress:
        """Render the press with the fitted paints; level "a" is the paper's emitter, for comparison."""
        from sim.experiments import FingerScene, Rendering, paint_optics, simulate_press

        finger = self._finger(self.design(), {c: paint_optics(p) for c, p in self.calibrations().items()})
        samples = self.settings.effort.samples_per_pixel // (1 if level == "b" else 2)
        scene = FingerScene(finger, self.calibrations(), self.shapes())
        press = simulate_press(scene, Rendering(level, self.settings.seed, samples), self._digests(), progress)
        return self._store(press, PRESS[level], [SURFACES, *(f"{c}/paint.json" for c in COLOURS)])

    def sweep(self, progress: Progress) -> LightAngleSweep:
        """Sweep the light angle with the fitted paints."""
        from sim.experiments import paint_optics

        calibrations = self.calibrations()
        finger = self._finger(self.design(), {c: paint_optics(p) for c, p in calibrations.items()})
        sweep = self._swept(finger, calibrations, SWEEP_REPEATS, self.settings.seed, progress)
        return self._store(sweep, SWEEP, [SURFACES, *(f"{c}/paint.json" for c in COLOURS)])

    def other_sweeps(self, progress: Progress) -> None:
        """Sweep the light angle with the finger touched at other places, by presses of a formula."""
        from sim.experiments import paint_optics

        calibrations = self.calibrations()
        paints = {c: paint_optics(p) for c, p in calibrations.items()}
        for place_mm, name in zip(OTHER_PLACES_MM, OTHER_SWEEPS, strict=True):
            finger = self._finger(self.design_at(place_mm), paints)
            sweep = self._swept(finger, calibrations, SWEEP_REPEATS, self.settings.seed, progress, pressed=False)
            self._store(sweep, name, [f"{c}/paint.json" for c in COLOURS])

    def true_sweeps(self, progress: Progress) -> None:
        """Sweep the light angle of the hidden true finger: what the decision is worth, for the report only."""
        seed = self.settings.seed + TWIN_SEED
        sweep = self._swept(self.true_finger(), {}, TRUE_SWEEP_REPEATS, seed, progress)
        self._store(sweep, TRUE_SWEEP, [SURFACES])
        for place_mm, name in zip(OTHER_PLACES_MM, OTHER_TRUE_SWEEPS, strict=True):
            finger = self.true_finger(self.design_at(place_mm))
            self._store(self._swept(finger, {}, TRUE_SWEEP_REPEATS, seed, progress, pressed=False), name, [])

    def true_finger(self, design: FingerDesign | None = None) -> "PaintedFinger":
        """Return the finger as it was really built: true paints, light and coating a little off."""
        from sim.experiments import as_built_design

        paints = {colour: true_paint_optics(colour, self.truth(colour)) for colour in COLOURS}
        return self._finger(as_built_design(design or self.design()), paints)

    def twin(self, progress: Progress) -> TactileCapture:
        """Capture the digital twin: hidden true paints, another light angle, coating and seed."""
        from sim.experiments import capture_twin

        capture = capture_twin(
            self.true_finger(), self.design().light.angle_deg, self.settings.seed + TWIN_SEED,
            self.settings.effort.twin_samples_per_pixel, progress, self.shapes(),
            self.settings.effort.twin_samples_per_pixel,
        )  # fmt: skip
        return self._store(capture, CAPTURE, [SURFACES])

    def compare(self, level: "Level" = "b") -> PhotometricErrorReport:
        """Compare the stored render of a level with the stored capture."""
        from finray_calib.compare import compare_press

        press = read_record(self.path(PRESS[level]), SimulatedPress)
        capture = read_record(self.path(CAPTURE), TactileCapture)
        report = compare_press(press, capture, self.settings.seed)
        return self._store(report, REPORT[level], [PRESS[level], CAPTURE])

    def decide(self) -> LightAngleDecision:
        """Decide on the light angle from the stored sweeps of all places and the report."""
        from finray_calib.decide import decide

        sweeps = [read_record(self.path(name), LightAngleSweep) for name in (SWEEP, *OTHER_SWEEPS)]
        report = read_record(self.path(REPORT["b"]), PhotometricErrorReport)
        sweeps.sort(key=lambda sweep: sweep.design.indenter.position_mm)
        decision = decide(sweeps, [report], self.settings.seed)
        return self._store(decision, DECISION, [SWEEP, *OTHER_SWEEPS, REPORT["b"]])

    def _swept(
        self,
        finger: "PaintedFinger",
        calibrations: Mapping[str, PaintCalibration],
        repeats: int,
        seed: int,
        progress: Progress,
        pressed: bool = True,
    ) -> LightAngleSweep:
        """Sweep the light angle of a finger, pressed by finite elements or by a formula."""
        from sim.experiments import light_angle_sweep
        from sim.optics import ProbePaths

        digests = self._digests() if calibrations else {}
        paths = ProbePaths(self.settings.effort.probe_samples, repeats, seed)
        shapes = self.shapes() if pressed else None
        return light_angle_sweep(finger, calibrations, ANGLES_DEG, paths, digests, progress, shapes=shapes)

    def _finger(self, design: FingerDesign, paints: "Mapping[str, PaintOptics]") -> "PaintedFinger":
        """Join design, paints, the tactile camera's response and the renderer."""
        from data_schemas.storage import camera_response
        from sim.experiments import PaintedFinger

        return PaintedFinger(design, paints, camera_response(design.camera.response, self.settings.out), self.renderer)

    def _digests(self) -> dict[str, str]:
        """Return the SHA-256 of both paint calibrations as they were read."""
        return {colour: digest_of_input(self.path(f"{colour}/paint.json")) for colour in COLOURS}

    def _store(self, record: R, name: str, inputs: list[str]) -> R:
        """Store a product with its provenance and return it as the next stage reads it."""
        digests = {name: digest_of_input(self.path(name)) for name in inputs}
        origin = provenance(self.settings.command, digests, self.settings.seed)
        return read_record(write_record(record, self.path(name), origin), type(record))


def true_paint_optics(colour: str, truth: "BenchTruth") -> "PaintOptics":
    """Return the optics of the true paint on the bench (measurement noise below zero is cut)."""
    import numpy as np

    from sim.optics import PaintOptics

    emission, reflectance = truth.emission, truth.reflectance
    wavelength_nm = emission.wavelength_nm
    blue_nm = np.arange(380.0, wavelength_nm[0])
    grid_nm = np.concatenate([blue_nm, wavelength_nm])
    return PaintOptics(
        name=f"true {colour} paint",
        wavelength_nm=grid_nm,
        emission_per_nm=np.concatenate([np.zeros_like(blue_nm), np.maximum(emission.values, 0.0)]),
        reflectance=np.clip(reflectance(grid_nm), 0.0, 1.0),
        absorption_rel=np.maximum(truth.absorption(grid_nm), 0.0),
    )


def _write_once(path: Path, content: bytes) -> None:
    """Write a file that a run before may have written already.

    Raises
    ------
    RecordError
        It holds something else.
    """
    if not (path.is_file() and read_bytes(path) == content):
        write_bytes(path, content)


def settings_json(settings: DemoSettings, engine: RendererChoice) -> dict[str, Any]:
    """Return settings and renderer as JSON, for the processes of the stages."""
    return {
        **{name: getattr(settings, name) for name in ("seed", "command")},
        "out": str(settings.out),
        "materials": {colour: str(path) for colour, path in settings.materials.items()},
        "sensor": None if settings.sensor is None else str(settings.sensor),
        "effort": asdict(settings.effort),
        "engine": asdict(engine),
    }


def demo_of(stored: Mapping[str, Any]) -> Demo:
    """Return the demo of settings as :func:`settings_json` wrote them."""
    settings = DemoSettings(
        out=Path(stored["out"]),
        materials={colour: Path(path) for colour, path in stored["materials"].items()},
        sensor=None if stored["sensor"] is None else Path(stored["sensor"]),
        seed=stored["seed"],
        command=stored["command"],
        effort=RenderEffort(**stored["effort"]),
    )
    return Demo(settings, RendererChoice(**stored["engine"]))


def run_stage(settings: Mapping[str, Any], what: str, arguments: Mapping[str, Any]) -> None:
    """Run a stage in a process of its own: a method of :class:`Demo` that stores its product."""
    method = getattr(demo_of(settings), what)
    method(**arguments, **({"progress": progress_sender()} if what in WITH_PROGRESS else {}))
