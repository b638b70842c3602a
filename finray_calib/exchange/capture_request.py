"""Tell a lab exactly which captures to take: a page for people, and tactile plans for 'finray capture'."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from data_schemas.design import FingerDesign
from data_schemas.errors import RecordError
from finray_calib.exchange.capture_request_page import capture_request_page
from finray_calib.exchange.requested_presses import PlannedView, ball_presses, indenter_presses
from finray_calib.exchange.tactile_plan_text import tactile_plan_text

ANGLES_DEG: Final = (0.0, 30.0, 60.0, 90.0)
"""Panel angles of the sweep, the design's own beside them."""


@dataclass(frozen=True, slots=True)
class CaptureRequest:
    """A page (Markdown) and the plans that it speaks of, file name -> TOML."""

    page: str
    plans: dict[str, str]


def capture_request(
    design: FingerDesign, design_file: str, stem: str, view: PlannedView, angles_deg: Sequence[float] = ANGLES_DEG
) -> CaptureRequest:
    """Return what a lab must capture so that a design can be compared, its normals sensed and its light decided.

    One plan of ball presses teaches the normal map; one plan for each panel angle presses the design's own indenter.
    Depths are shares of the design's depth (of the pad's thickness for the ball).

    Parameters
    ----------
    design
        The finger; its indenter is pressed at the panel angles.
    design_file
        Its file, as the plans name it.
    stem
        File name of the page without ".md"; the plans are named after it.
    view
        What the design's camera sees: the balls are pressed there, and the plans hold its scale.
    angles_deg
        Panel angles of the sweep, deg; the design's own is added.

    Raises
    ------
    RecordError
        When the design's indenter is none that a tactile plan knows, it does not press, the pad is too small for a
        ball, or two angles would share a plan.
    """
    own, ball = indenter_presses(design), ball_presses(design, view)
    plans = {
        f"{stem}.ball.toml": tactile_plan_text(design, design_file, ball, view, design.light.angle_deg, board=True)
    }
    for angle in sorted({*angles_deg, design.light.angle_deg}):
        name = f"{stem}.angle-{angle:g}.toml"
        if name in plans:
            raise RecordError(
                f"panel angle of {float(angle)!r} deg: the plan of another angle is named {name} too; round the "
                "angles, and light.angle_deg of the design, to six digits"
            )
        plans[name] = tactile_plan_text(design, design_file, own, view, angle, board=False)
    return CaptureRequest(capture_request_page(design, ball, own, tuple(plans)), plans)
