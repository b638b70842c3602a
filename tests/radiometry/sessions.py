"""Synthetic paint sessions whose every signal is known: uniform light on a small Bayer sensor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data_schemas import (
    BandPassFilter,
    CameraSettings,
    CaptureSession,
    FilterWheelSettings,
    Frame,
    FrameType,
    HiddenPaint,
    PaintPlan,
    RegionOfInterest,
    RigFile,
    SimulatedBench,
    SpectralCurve,
)

FILTERS = ("450", "500", "600", "660")
SIDE_PX = 64
TILT_DEG = 30.0
DOSE_PER_FRAME_J = 0.01
REGION = RegionOfInterest(row_px=8, column_px=8, height_px=48, width_px=48)
PAINT = HiddenPaint(name="p", mode_nm=600, fwhm_nm=50, asinh_skewness=1, energy_yield=0.2, absorption_peak_nm=500)
CAMERA = CameraSettings(width_px=SIDE_PX, height_px=SIDE_PX)
# DN per second of each frame type over (filter, channel red green blue); zero stands for no light at all.
WHITE = np.array([[300, 900, 6000], [500, 4000, 2500], [9000, 1500, 200], [8000, 800, 100.0]])
SIGNALS: dict[FrameType, np.ndarray] = {
    "white": WHITE,
    "reflectance": WHITE * np.array([[0.05], [0.06], [0.5], [0.8]]),
    "fluorescence": np.array([[20, 60, 400], [0.3, 2, 1.5], [60, 10, 1.4], [15, 1.5, 0.2]]),
}
LASER_WHITE = np.array([[400.0, 1200.0, 8000.0]])


@dataclass
class SyntheticSession:
    """A session record and the frames behind it."""

    session: CaptureSession
    frames: dict[str, np.ndarray]

    def read(self, frame: Frame) -> np.ndarray:
        return self.frames[frame.file]


def rig() -> RigFile:
    filters = tuple(BandPassFilter(slot=i, name=n, center_nm=float(n)) for i, n in enumerate(FILTERS, 1))
    return RigFile(
        name="r",
        camera=CAMERA,
        filter_wheel=FilterWheelSettings(filters=filters),
        simulated=SimulatedBench(paint=PAINT),
    )


def exact_white(synthetic: SyntheticSession) -> CaptureSession:
    """The session with an exactly known white tile, so that its uncertainty is not part of the claim."""
    white = synthetic.session.rig.white_reference.model_copy(update={"uncertainty_rel": 0.0})
    rig = synthetic.session.rig.model_copy(update={"white_reference": white})
    return synthetic.session.model_copy(update={"rig": rig})


def expected() -> tuple[np.ndarray, np.ndarray]:
    """The noise-free fluorescence and total radiance factor."""
    # V uses weights that depend on noise, but with V_c / W_c equal in all channels any weights give the same level.
    level = LASER_WHITE[0] / WHITE[0]
    np.testing.assert_allclose(level, level[0])
    return SIGNALS["fluorescence"] / WHITE / level[0], 0.98 * SIGNALS["reflectance"] / WHITE


def synthetic_session(
    rng: np.random.Generator,
    repeatability_rel: float = 0.002,
    change: Callable[[list[Frame], dict[str, np.ndarray]], list[Frame]] | None = None,
    extra: Sequence[tuple[FrameType, str, np.ndarray]] = (),
    loss_per_j: float = 0.0,
    exposure_s: float | None = None,
    light: Callable[[FrameType], np.ndarray | float] = lambda kind: 1.0,
) -> SyntheticSession:
    """A session of known light.

    `extra` steps (type, filter, DN per second) come last; `loss_per_j` fades what the laser excites behind all filters
    but the first, which passes the laser; `exposure_s` replaces all exposures; `light` gives a frame type's
    irradiance per pixel.
    """
    frames: list[Frame] = []
    images: dict[str, np.ndarray] = {}
    dose_j = 0.0

    def add(frame_type: FrameType, name: str | None, exposure_s: float, dn_per_s: np.ndarray) -> None:
        file = f"frames/{len(frames):04d}.tiff"
        images[file] = expose(dn_per_s, exposure_s, rng, light(frame_type))
        made = frame(len(frames), file, frame_type, name, exposure_s)
        tilt_deg = TILT_DEG if frame_type == "tilted fluorescence" else 0.0
        frames.append(made.model_copy(update={"laser_dose_j": dose_j, "tilt_deg": tilt_deg}))

    plan: list[tuple[FrameType, str, np.ndarray]] = [
        (kind, name, table[b]) for kind, table in SIGNALS.items() for b, name in enumerate(FILTERS)
    ]
    plan += [("laser white", "450", LASER_WHITE[0]), *extra]
    exposures = {id(dn): exposure_s or 0.7 * 1007 / max(dn.max(), 1.0) for *_, dn in plan}
    factors = (1.0, 0.25) if exposure_s is None else (1.0,)
    times = sorted({t * factor for t in exposures.values() for factor in factors})
    for t in times:
        add("dark", None, t, np.zeros(3))
    for kind, name, dn in plan:
        for factor in factors:
            level = 1.0 + repeatability_rel * rng.standard_normal()
            if "fluorescence" in kind:
                dose_j += DOSE_PER_FRAME_J
                level *= 1.0 if name == FILTERS[0] else np.exp(-loss_per_j * dose_j)
            add(kind, name, exposures[id(dn)] * factor, dn * level)
    for t in times:
        add("dark", None, t, np.zeros(3))
    kept = change(frames, images) if change else frames
    return SyntheticSession(record(tuple(kept)), images)


def expose(
    dn_per_s: np.ndarray, exposure_s: float, rng: np.random.Generator, light: np.ndarray | float = 1.0
) -> np.ndarray:
    mean_dn = np.zeros((SIDE_PX, SIDE_PX))
    mean_dn[0::2, 0::2], mean_dn[1::2, 1::2] = dn_per_s[0], dn_per_s[2]
    mean_dn[0::2, 1::2] = mean_dn[1::2, 0::2] = dn_per_s[1]
    mean_dn *= light
    gain, read_e = CAMERA.gain_e_per_dn, CAMERA.read_noise_e
    electrons = rng.poisson(mean_dn * exposure_s * gain) + read_e * rng.standard_normal(mean_dn.shape)
    return np.clip(np.rint(electrons / gain + CAMERA.black_level_dn), 0, 1023).astype(np.uint16)


def frame(sequence: int, file: str, frame_type: FrameType, name: str | None, exposure_s: float) -> Frame:
    return Frame(
        sequence=sequence, file=file, frame_type=frame_type, target="sample", light="off", filter_name=name,
        slot_before=1, slot_after=1, exposure_requested_s=exposure_s, exposure_s=exposure_s,
        captured_utc="2026-01-01T00:00:00+00:00", saturated_fraction=0.0, sha256="0" * 64,
    )  # fmt: skip


def record(frames: tuple[Frame, ...], region: RegionOfInterest = REGION) -> CaptureSession:
    flat = SpectralCurve(name="flat", wavelength_nm=[380.0, 780.0], values=[1.0, 1.0], source="test")
    return CaptureSession(
        plan=PaintPlan(paint_name="p", region=region),
        rig=rig(),
        camera_response=(flat, flat, flat),
        lamp=flat,
        frames=frames,
    )
