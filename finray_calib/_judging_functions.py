"""The functions of the library that judge a simulated finger: against a capture or a measured force, and its light.

They stand apart from those of a paint, which need no records of fingers: those take a tenth of a second to load.
"""

import os
from collections.abc import Sequence
from typing import Literal

from data_schemas import (
    CompareError,
    DecideError,
    ForceComparison,
    LightAngleDecision,
    LightAngleSweep,
    NormalMapRecord,
    PhotometricErrorReport,
    PixelScale,
    PressMechanics,
    SimulatedPress,
    TactileCapture,
)
from data_schemas.storage import given_path
from finray_calib._arguments import PathLike, checked_seed, given, given_list, made, naming, require_truths


def compare_press(
    simulated: SimulatedPress | PathLike,
    capture: TactileCapture | PathLike,
    *,
    register: bool = False,
    despite_mismatch: bool = False,
    relative: bool = False,
    normal_map: NormalMapRecord | PathLike | None = None,
    pixel_scale: PixelScale | PathLike | None = None,
    seed: int = 1,
) -> PhotometricErrorReport:
    """Compare a simulated press with a tactile capture: skill over the contact and its halo, with floor and interval.

    Parameters
    ----------
    simulated, capture
        The two presses.
    register
        Whether to move the render by the drift of the camera; otherwise the drift is only told.
    despite_mismatch
        Whether to compare images that do not belong together; the report says so.
    relative
        Judge the change by contact alone: the captured image without contact stands in the place of the render's.
    normal_map
        Of the capture's sensor: normals and depth are then compared too.
    pixel_scale
        Of the capture's camera: patch and halo are then also given in mm.
    seed
        Of the random generator.

    Raises
    ------
    CompareError
        The images do not belong together.
    """
    from finray_calib.compare import CheckOptions, compare_checked

    seed = checked_seed(seed)
    require_truths(register=register, despite_mismatch=despite_mismatch, relative=relative)
    press, files = given(simulated, SimulatedPress)
    captured, read = given(capture, TactileCapture)
    files += read
    normals, scale = None, None
    if normal_map is not None:
        normals, read = given(normal_map, NormalMapRecord)
        files += read
    if pixel_scale is not None:
        scale, read = given(pixel_scale, PixelScale)
        files += read
    with naming(CompareError, *files):
        options = CheckOptions(register, despite_mismatch, normals, scale, relative=relative)
        report, _ = compare_checked(press, captured, seed, options)
    return made(report, "compare_press", files, seed)


def compare_force(
    press: PressMechanics | PathLike,
    force_csv: PathLike,
    *,
    known_first_touch: bool = False,
    other_mesh: PressMechanics | PathLike | None = None,
    seed: int = 1,
) -> ForceComparison:
    """Compare the force of a press by finite elements with a measured one.

    Parameters
    ----------
    press
        The mechanics of a press, see :func:`finray_calib.press_finger`.
    force_csv
        Columns displacement_mm and force_n; if known force_uncertainty_n and displacement_uncertainty_mm.
    known_first_touch
        Whether displacements count from first touch; otherwise first touch is fitted.
    other_mesh
        The same press on another mesh, for the uncertainty of the mesh.
    seed
        Of the random generator.
    """
    import numpy as np

    from finray_calib.exchange import read_force_csv
    from finray_calib.force import compare_force as compare

    seed = checked_seed(seed)
    require_truths(known_first_touch=known_first_touch)
    mechanics, files = given(press, PressMechanics)
    other, read = (None, []) if other_mesh is None else given(other_mesh, PressMechanics)
    force_file = given_path(force_csv, "force_csv")
    measured = read_force_csv(force_file)
    with naming(CompareError, *files):
        compared = compare(mechanics, measured, np.random.default_rng(seed), not known_first_touch, other)
    return made(compared, "compare_force", [*files, force_file, *read], seed)


def decide_light_angle(
    sweeps: LightAngleSweep | PathLike | Sequence[LightAngleSweep | PathLike],
    reports: Sequence[PhotometricErrorReport | PathLike] = (),
    *,
    narrow_sweep: bool = False,
    weights: Sequence[float] | None = None,
    criterion: Literal["average", "worst"] = "average",
    aim: Literal["brightness", "normal"] | None = None,
    seed: int = 1,
) -> LightAngleDecision:
    """Decide on the angle of the light over touches of a finger: the angle, its risk, and what each touch loses.

    Parameters
    ----------
    sweeps
        One for each touch, see :func:`finray_calib.sweep_light_angle`; one alone decides for its place only.
    reports
        Comparisons with captures, see :func:`compare_press`; without any the decision is not validated.
    narrow_sweep
        Whether angles that span less than 4 deg are meant so, and are not radians.
    weights
        How often each touch occurs, in the order of the sweeps; by default all alike.
    criterion
        "average": the least loss on average over the touches; "worst": at the worst of them.
    aim
        "brightness" of the touches, or expected error of the sensed "normal" at places along the pad; by default the
        latter where a sweep holds it (``all_objectives=True``) and neither reports nor weights are given.
    seed
        Of the random generator.

    Raises
    ------
    DecideError
        The sweeps allow no decision or do not belong together, or a report is not of this finger.
    """
    from finray_calib.decide import decide

    seed = checked_seed(seed)
    require_truths(narrow_sweep=narrow_sweep)
    alone = isinstance(sweeps, LightAngleSweep | str | os.PathLike)
    several = [sweeps] if alone else given_list(sweeps, LightAngleSweep, "sweeps")
    swept = [given(sweep, LightAngleSweep) for sweep in several]
    files = [file for _, read in swept for file in read]
    compared = [given(of, PhotometricErrorReport) for of in given_list(reports, PhotometricErrorReport, "reports")]
    files += [file for _, read in compared for file in read]
    with naming(DecideError, *files):
        decision = decide(
            [sweep for sweep, _ in swept],
            [report for report, _ in compared],
            seed,
            narrow_sweep,
            weights,
            criterion,
            aim,
        )
    return made(decision, "decide_light_angle", files, seed)
