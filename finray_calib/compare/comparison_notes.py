"""What a reader of a comparison must know: what its intervals cover, what they leave out, and what is withheld."""

from data_schemas.capture import TactileCapture
from data_schemas.compare import MonteCarlo
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.input_draws import POSE, Inputs
from finray_calib.compare.quiet_comparison import LARGEST_HEADLINE_NOISE
from finray_calib.compare.stopping_rule import Propagated

COVERS_INPUTS = (
    "the metric between the noise-free capture and the noise-free render with the true paints, camera and pose: what "
    "the inputs of the budget leave open, with 95 % probability; noise is taken out of every error"
)
COVERS_PARTS = (
    "how much a number depends on which part of the region was looked at (tiles drawn with replacement): no input of "
    "this image has a known uncertainty"
)
ALWAYS_UNKNOWN = (
    "another press, day or finger: that needs more captures",
    "the fixed pattern of the camera, and light that the design does not hold",
)


def monte_carlo(draws: Propagated | None, press: SimulatedPress, inputs: Inputs | None) -> MonteCarlo | None:
    """Say how the intervals were propagated and what they leave out."""
    if draws is None or inputs is None:
        return None
    left_out = [*ALWAYS_UNKNOWN]
    known = press.known_inputs.names if press.known_inputs is not None else ()
    left_out += [
        f"the {name}, of which the press holds no draws"
        for name in ("red paint", "green paint", "camera response")
        if name not in known
    ]
    left_out += [
        f"the {POSE[name]}: the capture states no uncertainty of it, or the render no derivative (--pose-response)"
        for name in POSE
        if name not in inputs.pose_names
    ]
    return MonteCarlo(
        draws=len(draws.draws["exposure"]),
        significant_digits=draws.significant_digits,
        not_included=tuple(left_out),
    )


def withheld(press: SimulatedPress, capture: TactileCapture, is_propagated: bool) -> tuple[str, ...]:
    """Say which figures an unknown encoding, or a press of unknown inputs, does not allow."""
    if is_propagated:
        return ()
    if capture.encoding == "linear":
        return (
            "the error of the sweep's objective, budget and validation are not given: no input of "
            f"{press.name} has a known uncertainty",
        )
    return (
        "relative RMS, gradient and colour error, exposure factor, objective and validation are not given: the "
        f"encoding of {capture.name} is unknown, so its values are not proportional to light",
    )


def notes_of(press: SimulatedPress, capture: TactileCapture, block_px: int) -> tuple[str, ...]:
    """Collect what a reader must know."""
    notes, linear = list(press.notes), capture.encoding == "linear"
    if block_px > 1:
        notes.append(
            f"compared over blocks of {block_px} x {block_px} px, at most a quarter of the contact's half-width, so "
            f"that noise leaves the headline uncertain by {LARGEST_HEADLINE_NOISE:g}, or as little as such blocks allow"
        )
    if capture.repeat_no_contact is None:
        notes.append("no repeat of the no-contact image: neither the floor nor the camera's noise is known")
        notes.append(
            "that there is a touch was told from noise as neighbouring pixels show it: noise that they share (JPEG, "
            "interpolated colours) can pass for a touch"
        )
    elif not linear:
        notes.append("the noise of encoded images is not known: it stays in their errors")
    if linear and press.contact_half_difference is None:
        notes.append("the render holds no halves: its noise stays in its errors")
    return tuple(notes)
