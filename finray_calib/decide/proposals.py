"""The next render and the next physical capture: the angles at which they are expected to help most."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.decide.capture_errors import CaptureErrors
from finray_calib.decide.knowledge_gradient import knowledge_gradient
from finray_calib.decide.light_angle import AngleDecision
from finray_calib.decide.validating_captures import UNSTATED_ANGLE_SD_DEG

Floats = NDArray[np.float64]

#: Standard uncertainty of the objective in a capture, where there is none to learn it from.
ASSUMED_CAPTURE_SD_REL = 0.01
#: A smaller expected rise of the objective is not worth an observation.
LEAST_GAIN_REL = 1e-4


@dataclass(frozen=True, slots=True)
class Proposal:
    """Hold the best angle for one more observation.

    Attributes
    ----------
    angle_deg : float
    gain_rel : float
        Expected rise of the greatest expected objective, relative to it.
    noise_rel : float
        Assumed standard uncertainty of the observation.
    """

    angle_deg: float
    gain_rel: float
    noise_rel: float


def propose_render(decision: AngleDecision) -> Proposal | None:
    """Return the angle to render next, as many repeats as the sweep has; None where it would change nothing.

    Valid for repeats with the same draws as those of the sweep, so that they share its scale.
    """
    simulated = decision.simulated
    curve = simulated.posterior
    noise_rel = simulated.noise_rel / np.sqrt(simulated.repeats)
    noise_variance = np.full(len(curve.grid_deg), noise_rel**2)
    response = np.exp(-decision.discrepancy.shape_mean)[:, None] * curve.covariance
    return _best(decision, response, np.diag(curve.covariance), noise_variance)


def propose_capture(decision: AngleDecision, captures: CaptureErrors) -> Proposal | None:
    """Return the angle to capture next; None where it would change nothing.

    A capture shows the sim-to-real error at its angle, with the noise of the captures so far (median; 1 % and 2 deg
    without any). That it also tells the amplitude of that error is not counted.
    """
    sd_rel, angle_sd_deg = ASSUMED_CAPTURE_SD_REL, UNSTATED_ANGLE_SD_DEG
    if captures.names:
        sd_rel = float(np.sqrt(np.median(np.diag(captures.covariance))))
        angle_sd_deg = float(np.median(captures.angle_sd_deg))
    noise_variance = sd_rel**2 + (decision.simulated.log_slope_per_deg * angle_sd_deg) ** 2
    discrepancy = decision.discrepancy
    response = -decision.mean_rel[:, None] * discrepancy.shape_response
    return _best(decision, response, np.diag(discrepancy.covariance), noise_variance)


def _best(
    decision: AngleDecision, response: Floats, observed_variance: Floats, noise_variance: Floats
) -> Proposal | None:
    """Return the candidate of the grid with the greatest knowledge gradient."""
    choices = decision.choices
    mean = decision.mean_rel[choices]
    gains = knowledge_gradient(mean, response[choices], observed_variance, noise_variance)
    best = int(gains.argmax())
    gain_rel = float(gains[best] / mean.max())
    if gain_rel < LEAST_GAIN_REL:
        return None
    grid_deg = decision.simulated.posterior.grid_deg
    return Proposal(float(grid_deg[best]), gain_rel, float(np.sqrt(noise_variance[best])))
