"""Calibrate fluorescent-paint tactile fingers: the library that people call, one function per stage.

>>> import finray_calib as finray
>>> paint = finray.fit_paint("bands.json")          # or a BandSignals
>>> paint.mode_nm                                   # 598.6 [589.9, 605.8] nm
>>> paint.plot().save("paint.svg")
>>> press = finray.render_press("flat-70x35", red="red.paint.json", green=paint)
>>> report = finray.compare_press(press, "capture.json")
>>> finray.write_record(report, "report.json")

Functions take records or the paths of stored ones, and return records; the command line calls the same code.

    capture     open_rig, capture_session
    radiometry  reduce_session, reduce_pixels, import_bands, import_signals
    fit         fit_paint, map_paint
    simulate    finger_design, press_finger, render_press, render_images, recolour_press, sweep_light_angle
                render_sensor, fit_sensor
    compare     compare_press, compare_force
    decide      decide_light_angle
    any stage   read_record, write_record, trace_record

``help(finray.fit_paint)`` explains one function; printing a record shows its main numbers. The packages below (`fit`,
`compare`, `reports` ...) hold what each stage does. Names are loaded when they are asked for.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from data_schemas import (
        BandSignals,
        CameraCharacterisation,
        CaptureSession,
        FingerDesign,
        FingerSurfaces,
        FinrayError,
        ForceComparison,
        LightAngleDecision,
        LightAngleSweep,
        PaintCalibration,
        PaintMap,
        PaintWithoutEmission,
        PhotometricErrorReport,
        PixelSignals,
        PressMechanics,
        Record,
        RigFile,
        SensorFit,
        SimulatedPress,
        TactileCapture,
    )
    from finray_calib._finger_functions import (
        FingerPress,
        RenderOptions,
        finger_design,
        fit_sensor,
        press_finger,
        recolour_press,
        render_images,
        render_press,
        render_sensor,
        sweep_light_angle,
    )
    from finray_calib._library import (
        capture_session,
        compare_force,
        compare_press,
        decide_light_angle,
        fit_paint,
        import_bands,
        import_signals,
        map_paint,
        open_rig,
        read_record,
        reduce_pixels,
        reduce_session,
        trace_record,
        write_record,
    )
    from finray_calib.exchange import SignalOptions

    __version__: str

NEIGHBOURS = ("data_schemas", "rigs", "sim")


def require_own_packages(root: Path, names: tuple[str, ...] = NEIGHBOURS) -> None:
    """Refuse a package of one of these names that does not stand in `root`, the folder that holds finray_calib.

    Raises
    ------
    ImportError
        One is missing, or is another package of that name.
    """
    for name in names:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ImportError(
                f"finray_calib needs the package '{name}', but it is missing from {root}; install finray-calib again"
            )
        if Path(spec.origin).resolve().parent.parent != root.resolve():
            raise ImportError(
                f"finray_calib needs its own package '{name}', but Python finds a different package of the same name "
                f"at {spec.origin}; rename that package, start Python from another folder, or install finray-calib in "
                "a separate environment"
            )


require_own_packages(Path(__file__).parent.parent)

if not TYPE_CHECKING:
    from data_schemas import lazy_exports, register_record_methods

    register_record_methods(
        plot="finray_calib.reports:plot_record",
        to_xarray="finray_calib.exchange:record_dataset",
        to_inferencedata="finray_calib.exchange:inference_data",
    )
    _load = lazy_exports(__name__, __file__)

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from data_schemas import package_version

            return package_version()
        return _load(name)


def __dir__() -> list[str]:
    return sorted(__all__)


__all__ = [
    "BandSignals",
    "CameraCharacterisation",
    "CaptureSession",
    "FingerDesign",
    "FingerPress",
    "FingerSurfaces",
    "FinrayError",
    "ForceComparison",
    "LightAngleDecision",
    "LightAngleSweep",
    "PaintCalibration",
    "PaintMap",
    "PaintWithoutEmission",
    "PhotometricErrorReport",
    "PixelSignals",
    "PressMechanics",
    "Record",
    "RenderOptions",
    "RigFile",
    "SensorFit",
    "SignalOptions",
    "SimulatedPress",
    "TactileCapture",
    "__version__",
    "capture_session",
    "compare_force",
    "compare_press",
    "decide_light_angle",
    "finger_design",
    "fit_paint",
    "fit_sensor",
    "import_bands",
    "import_signals",
    "map_paint",
    "open_rig",
    "press_finger",
    "read_record",
    "recolour_press",
    "reduce_pixels",
    "reduce_session",
    "render_images",
    "render_press",
    "render_sensor",
    "sweep_light_angle",
    "trace_record",
    "write_record",
]
