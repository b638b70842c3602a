"""Capture sessions: from a plan and a rig to a folder of raw frames with checksums that anybody can verify.

One engine for four kinds of session (paint, camera, tactile, check): steps in order, exposures metered and read back,
the filters proven optically, every frame on disk with its SHA-256 and a line of a chained journal before the next step
begins. An interrupted session continues from its journal; a finished one can be verified without anything else.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.capture._camera_session import camera_step, camera_times, capture_camera_session
    from rigs.capture._check_press import check_press_plan, record_press_facts
    from rigs.capture._check_session import check_filters, record_facts
    from rigs.capture._exposure import (
        CAMERA_DEADLINE_MARGIN_S,
        CAMERA_EXPOSURES,
        EXPOSURE_TOLERANCE_REL,
        WHEEL_DEADLINE_S,
        require_ready,
    )
    from rigs.capture._force_gauge import (
        ForceGauge,
        OpenTactileRig,
        calibration_notes,
        open_tactile_rig,
        read_cell_calibration,
    )
    from rigs.capture._frame_store import space_warning
    from rigs.capture._journal import JOURNAL_NAME, OtherCaptureError, StatedTimes, read_journal
    from rigs.capture._paint_session import Forecast, capture_paint_session, forecast
    from rigs.capture._plan import Step, paint_steps, planned_presses, tactile_shots
    from rigs.capture._resume import Interrupted, read_interrupted, unvouched_files
    from rigs.capture._session_folder import (
        SESSION_KINDS,
        SESSION_NAME,
        SessionRequest,
        SessionWatch,
        complete_session,
        is_unstarted,
        lacks_manifest,
        read_camera_session,
        read_frame_of,
        read_session,
        require_unfinished,
        session_kind,
        verify_session,
    )
    from rigs.capture._stage_press import StagePress, free_travel_guard
    from rigs.capture._tactile_session import (
        MOST_SATURATED_FRACTION,
        capture_tactile_session,
        is_tactile,
        read_interrupted_presses,
        require_pressable,
        session_bytes,
        stated_times,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CAMERA_DEADLINE_MARGIN_S",
    "CAMERA_EXPOSURES",
    "EXPOSURE_TOLERANCE_REL",
    "JOURNAL_NAME",
    "MOST_SATURATED_FRACTION",
    "SESSION_KINDS",
    "SESSION_NAME",
    "WHEEL_DEADLINE_S",
    "ForceGauge",
    "Forecast",
    "Interrupted",
    "OpenTactileRig",
    "OtherCaptureError",
    "SessionRequest",
    "SessionWatch",
    "StagePress",
    "StatedTimes",
    "Step",
    "calibration_notes",
    "camera_step",
    "camera_times",
    "capture_camera_session",
    "capture_paint_session",
    "capture_tactile_session",
    "check_filters",
    "check_press_plan",
    "complete_session",
    "forecast",
    "free_travel_guard",
    "is_tactile",
    "is_unstarted",
    "lacks_manifest",
    "open_tactile_rig",
    "paint_steps",
    "planned_presses",
    "read_camera_session",
    "read_cell_calibration",
    "read_frame_of",
    "read_interrupted",
    "read_interrupted_presses",
    "read_journal",
    "read_session",
    "record_facts",
    "record_press_facts",
    "require_pressable",
    "require_ready",
    "require_unfinished",
    "session_bytes",
    "session_kind",
    "space_warning",
    "stated_times",
    "tactile_shots",
    "unvouched_files",
    "verify_session",
]
