"""Everything a demo run produced, as the report reads it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, TactileCapture
from data_schemas.compare import ErrorRow, PhotometricErrorReport, RegionError
from data_schemas.decide import LightAngleDecision
from data_schemas.errors import RecordError
from data_schemas.fit import PaintCalibration
from data_schemas.press_mechanics import PressMechanics
from data_schemas.provenance import Provenance
from data_schemas.radiometry import BandSignals
from data_schemas.simulate import LightAngleSweep, SimulatedPress
from data_schemas.surfaces import FingerSurfaces
from finray_calib.reports.fitted_paint import FittedPaint, PaintTruth

Colour = Literal["red", "green"]
COLOURS: tuple[Colour, Colour] = ("red", "green")
STAGES = ("capture", "radiometry", "fit", "simulate", "compare", "decide")


@dataclass(frozen=True, slots=True)
class PaintResult:
    """One paint from capture to fit.

    Attributes
    ----------
    colour
        "red" or "green".
    room_light_rgb8
        (H, W, 3) preview of the sample under room light, sRGB code values.
    """

    colour: Colour
    session: CaptureSession
    bands: BandSignals
    calibration: PaintCalibration
    truth: PaintTruth
    room_light_rgb8: NDArray[np.uint8]

    @property
    def fitted(self) -> FittedPaint:
        """The paint as the sections on the fit show it."""
        return FittedPaint(self.bands, self.calibration, f"{self.colour} paint", self.truth)


@dataclass(frozen=True, slots=True)
class DemoResults:
    """All six stages of one run.

    Attributes
    ----------
    paints
        The two paints by colour.
    mechanics, surfaces
        The finger as finite elements pressed it; its shape is that of all renders. None where it was not shown.
    stage_wall_times_s
        Wall time of each of the six stages, s.
    renderer_note
        Which renderer made the images and what that means, in words.
    command
        The command that reproduces the run.
    true_sweep
        The same objective over the angle for the hidden true finger, or None when it was not rendered.
    report_level_a
        The paper's emitter (light textured by distance, the same at every angle) against the same capture, or
        None when it was not rendered.

    Raises
    ------
    RecordError
        When a paint or a stage is missing or unknown.
    """

    paints: dict[Colour, PaintResult]
    press: SimulatedPress
    capture: TactileCapture
    report: PhotometricErrorReport
    sweep: LightAngleSweep
    decision: LightAngleDecision
    stage_wall_times_s: dict[str, float]
    renderer_note: str
    command: str
    provenance: Provenance
    true_sweep: LightAngleSweep | None = None
    mechanics: PressMechanics | None = None
    surfaces: FingerSurfaces | None = None
    report_level_a: PhotometricErrorReport | None = None

    def __post_init__(self) -> None:
        if set(self.paints) != set(COLOURS):
            raise RecordError(f"demo results: paints are {sorted(self.paints)}; give exactly 'red' and 'green'")
        if set(self.stage_wall_times_s) != set(STAGES):
            raise RecordError(
                f"demo results: wall times (s) are given for {sorted(self.stage_wall_times_s)}; give exactly one "
                f"for each stage: {', '.join(STAGES)}"
            )


def headline(report: PhotometricErrorReport) -> RegionError:
    """Return the region that the report's headline score belongs to.

    Raises
    ------
    RecordError
        When the report holds no region of that name.
    """
    for region in report.regions:
        if region.region == report.headline_region:
            return region
    raise RecordError(
        f"photometric error report: headline region '{report.headline_region}' is not among its regions "
        f"({', '.join(repr(r.region) for r in report.regions)}); run compare again"
    )


def row_of(region: RegionError, candidate: str) -> ErrorRow | None:
    """Return the row of one candidate; None when it is absent (no repeat image, no floor)."""
    return next((row for row in region.rows if row.candidate == candidate), None)
