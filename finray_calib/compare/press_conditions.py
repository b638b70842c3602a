"""Refuse to compare a render with a capture that was taken under other stated conditions: light, indenter or push.

The design of the render is compared with the record of the capture; what either does not state is not judged.
"""

from data_schemas.capture import IndenterPose, TactileCapture
from data_schemas.errors import CompareError
from data_schemas.indenter import Indenter
from data_schemas.simulate import SimulatedPress

#: Angles are set by hand: this near, they are meant to be one.
_SAME_ANGLE_DEG = 1.0
#: Radii are typed from a drawing or measured by a calliper: this near, they are meant to be one.
_SAME_RADIUS_REL = 0.02
#: Depths and positions of one press as two files state them, where no uncertainty allows more.
_SAME_DEPTH_MM, _SAME_POSITION_MM = 0.05, 0.5
#: Differences up to so many stated standard uncertainties are one condition.
_STANDARD_UNCERTAINTIES = 3.0
_ROUND_SHAPES = ("cylinder", "ball")


def require_same_conditions(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse a render of another light, indenter or push than the capture's, with both numbers and what to do.

    Raises
    ------
    CompareError
        Angles of the light, shapes or radii of the indenter, depths or positions of the push differ by more than three
        stated standard uncertainties and by more than is one setting: 1 deg, 2 %, 0.05 mm, 0.5 mm.
    """
    _require_same_light(press, capture)
    if press.design is None:
        return
    _require_same_indenter(press.name, press.design.indenter, capture)
    _require_same_push(press.name, press.design.indenter, capture)


def _allowed(same: float, uncertainty: float | None) -> float:
    """Return the largest difference that is none."""
    # 2 and 1.95 are 0.05 apart although their difference in binary is a little more
    return max(same, _STANDARD_UNCERTAINTIES * (uncertainty or 0.0)) * (1.0 + 1e-9)


def _require_same_light(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse another angle of the light."""
    rendered_deg, captured_deg = press.light_angle_deg, capture.light_angle_deg
    if rendered_deg is None or captured_deg is None:
        return
    allowed_deg = _allowed(_SAME_ANGLE_DEG, capture.light_angle_uncertainty_deg)
    if abs(rendered_deg - captured_deg) > allowed_deg:
        raise CompareError(
            f"{press.name} is lit at {rendered_deg:g} deg, {capture.name} at {captured_deg:g} deg; up to "
            f"{allowed_deg:.2g} deg apart are one light: simulate with the capture's light.angle_deg"
        )


def _require_same_indenter(name: str, rendered: Indenter, capture: TactileCapture) -> None:
    """Refuse another shape or size; a capture states no size of cuboids and meshes."""
    captured = capture.indenter
    if rendered.shape != captured.shape:
        raise CompareError(
            f"{name} presses a {_described(rendered)}, {capture.name} a {_described(captured)}: simulate with the "
            "capture's indenter.shape and size, or correct the indenter of the capture's record"
        )
    if captured.shape not in _ROUND_SHAPES:
        return
    if abs(rendered.radius_mm / captured.radius_mm - 1.0) > _SAME_RADIUS_REL * (1.0 + 1e-9):
        raise CompareError(
            f"{name} presses a {_described(rendered)}, {capture.name} a {_described(captured)}; up to "
            f"{_SAME_RADIUS_REL:.0%} apart are one size: simulate with the capture's indenter.radius_mm"
        )


def _described(indenter: Indenter | IndenterPose) -> str:
    """Return shape, and radius where the shape has one."""
    radius = f" of radius {indenter.radius_mm:g} mm" if indenter.shape in _ROUND_SHAPES else ""
    return f"{indenter.shape}{radius}"


def _require_same_push(name: str, rendered: Indenter, capture: TactileCapture) -> None:
    """Refuse another depth or position along the pad."""
    captured = capture.indenter
    pairs = (
        ("depth_mm", "deep", "depth", _SAME_DEPTH_MM, captured.depth_uncertainty_mm),
        ("position_mm", "along the pad", "position", _SAME_POSITION_MM, captured.position_uncertainty_mm),
    )
    for field, where, what, same_mm, uncertainty_mm in pairs:
        rendered_mm, captured_mm = getattr(rendered, field), getattr(captured, field)
        allowed_mm = _allowed(same_mm, uncertainty_mm)
        if captured_mm is not None and abs(rendered_mm - captured_mm) > allowed_mm:
            raise CompareError(
                f"{name} is pressed {rendered_mm:g} mm {where}, {capture.name} {captured_mm:g} mm; up to "
                f"{allowed_mm:.2g} mm apart are one {what}: simulate with the capture's indenter.{field}, or, if it is "
                f"not known so well, state {field.removesuffix('_mm')}_uncertainty_mm in the capture"
            )
