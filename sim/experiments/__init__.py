"""Experiments with a painted finger: presses, captures, sweeps and studies, as records.

`paint_finger` joins a design with calibrated paints and a renderer. `simulate_press` renders a press as a record
(`simulate_images` its images too), `press_records` makes the records of one pressed by finite elements, `recoloured`
changes paints or camera of a stored press, `capture_twin` and `simulated_capture` pass a render through the sensor
model, `light_angle_sweep` measures the objectives of the light angle, and `paint_pairs` those of pairs of paints;
`press_protocol` says what a lab presses into a real sensor. A study (`study_...`, `reproduce_paper_paints`) returns a
record and draws nothing: reports do. Here mechanics and optics meet.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from sim.experiments._design_search import (
        OBJECTIVES,
        DesignEvaluations,
        DesignSpace,
        confirmed_losses,
        default_parameters,
        design_parameter,
        is_of_light,
        map_axis,
        map_designs,
        search_designs,
    )
    from sim.experiments._design_sensitivities import (
        block_force_model,
        finger_force_model,
        press_sensitivities,
        study_finger_stiffness,
    )
    from sim.experiments._finger_evaluation import (
        EvaluationSettings,
        FingerEvaluation,
        FingerEvaluator,
        LightMeasure,
        LitFinger,
    )
    from sim.experiments._illumination import (
        coat_cells,
        study_fluorescent_rendering,
        study_light_angle,
        study_two_lights,
    )
    from sim.experiments._learning_samples import (
        DEPTH_ZERO,
        REST_LEVEL,
        RenderedSample,
        SamplePaints,
        render_noise_rel,
        render_samples,
        sampled_paints,
    )
    from sim.experiments._light_angle import light_angle_sweep
    from sim.experiments._mechanical_press import grasp_record, increment_record, press_records, stored_press
    from sim.experiments._optics_products import (
        OpticsProducts,
        as_built_design,
        capture_twin,
        simulate_images,
        simulated_capture,
    )
    from sim.experiments._paint_choice import PaintDraws, PaintedPairs, UnpaintedFinger, paint_pairs
    from sim.experiments._painted_finger import (
        CameraResponse,
        FingerScene,
        PaintedFinger,
        design_digests,
        finger_scene,
        paint_finger,
        paint_optics,
        read_design_files,
        require_paints_in_order,
    )
    from sim.experiments._paper_paints import reproduce_paper_paints
    from sim.experiments._press_protocol import (
        BACK_MM,
        PressProtocol,
        PrintedSolid,
        ProtocolPress,
        press_protocol,
        protocol_solids,
    )
    from sim.experiments._press_surrogate import (
        DEFAULT_PRESSES,
        LIMIT_REL,
        SurrogateFinger,
        SurrogatePress,
        TrainingSettings,
        candidate_presses,
        press_family,
        train_surrogate,
    )
    from sim.experiments._rendered_press import (
        Rendering,
        WhiteBalance,
        camera_rgb,
        pose_response,
        press_record,
        recoloured,
        simulate_press,
        vividness,
    )
    from sim.experiments._sensor_fit import fit_sensor, fitted_design
    from sim.experiments._sensor_layers import (
        ClassicLayers,
        FingerLayers,
        FreeParameter,
        Layers,
        SensorScene,
        light_paths,
        powered_lights,
        render_each_light,
        value_at,
        with_changed_values,
        with_one_panel,
    )
    from sim.experiments._sensor_press import (
        BallPresses,
        PressedCoat,
        imprinted_shapes,
        pressed_coat,
        render_ball_presses,
        render_finger_presses,
        simulate_sensor_press,
    )
    from sim.experiments._taught_gel import FittedGel, GelParameter, fit_gel, predict_on_gel
    from sim.experiments._tolerance_study import (
        FingerError,
        ToleranceFindings,
        ToleranceInput,
        ToleranceSettings,
        study_tolerances,
        tolerance_inputs,
        varied_finger,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BACK_MM",
    "DEFAULT_PRESSES",
    "DEPTH_ZERO",
    "LIMIT_REL",
    "OBJECTIVES",
    "REST_LEVEL",
    "BallPresses",
    "CameraResponse",
    "ClassicLayers",
    "DesignEvaluations",
    "DesignSpace",
    "EvaluationSettings",
    "FingerError",
    "FingerEvaluation",
    "FingerEvaluator",
    "FingerLayers",
    "FingerScene",
    "FittedGel",
    "FreeParameter",
    "GelParameter",
    "Layers",
    "LightMeasure",
    "LitFinger",
    "OpticsProducts",
    "PaintDraws",
    "PaintedFinger",
    "PaintedPairs",
    "PressProtocol",
    "PressedCoat",
    "PrintedSolid",
    "ProtocolPress",
    "RenderedSample",
    "Rendering",
    "SamplePaints",
    "SensorScene",
    "SurrogateFinger",
    "SurrogatePress",
    "ToleranceFindings",
    "ToleranceInput",
    "ToleranceSettings",
    "TrainingSettings",
    "UnpaintedFinger",
    "WhiteBalance",
    "as_built_design",
    "block_force_model",
    "camera_rgb",
    "candidate_presses",
    "capture_twin",
    "coat_cells",
    "confirmed_losses",
    "default_parameters",
    "design_digests",
    "design_parameter",
    "finger_force_model",
    "finger_scene",
    "fit_gel",
    "fit_sensor",
    "fitted_design",
    "grasp_record",
    "imprinted_shapes",
    "increment_record",
    "is_of_light",
    "light_angle_sweep",
    "light_paths",
    "map_axis",
    "map_designs",
    "paint_finger",
    "paint_optics",
    "paint_pairs",
    "pose_response",
    "powered_lights",
    "predict_on_gel",
    "press_family",
    "press_protocol",
    "press_record",
    "press_records",
    "press_sensitivities",
    "pressed_coat",
    "protocol_solids",
    "read_design_files",
    "recoloured",
    "render_ball_presses",
    "render_each_light",
    "render_finger_presses",
    "render_noise_rel",
    "render_samples",
    "reproduce_paper_paints",
    "require_paints_in_order",
    "sampled_paints",
    "search_designs",
    "simulate_images",
    "simulate_press",
    "simulate_sensor_press",
    "simulated_capture",
    "stored_press",
    "study_finger_stiffness",
    "study_fluorescent_rendering",
    "study_light_angle",
    "study_tolerances",
    "study_two_lights",
    "tolerance_inputs",
    "train_surrogate",
    "value_at",
    "varied_finger",
    "vividness",
    "with_changed_values",
    "with_one_panel",
]
