"""Where one more observation helps most: the next render and the next physical capture (the knowledge gradient).

Exact for normal beliefs: the expected rise of the greatest expected objective.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from finray_calib.decide._capture_errors import UNSTATED_ANGLE_SD_DEG, CaptureErrors
from finray_calib.decide._light_angle import AngleDecision

Floats = NDArray[np.float64]


def expected_maximum_gain(intercepts: Floats, slopes: Floats) -> float:
    """Return E[max_i(a_i + b_i Z)] - max_i a_i for a standard normal Z.

    The maximum of the lines is piecewise linear and convex. With its lines in order of slope and the points c_i where
    line i gives way to line i + 1, the gain is sum_i (b_{i+1} - b_i) f(-|c_i|), f(z) = phi(z) + z Phi(z). Exact.

    Parameters
    ----------
    intercepts, slopes : ndarray, shape (G,)

    Returns
    -------
    float
        In the unit of the intercepts; never negative.

    References
    ----------
    P. Frazier, W. Powell, S. Dayanik, The knowledge-gradient policy for correlated normal beliefs, INFORMS J. Comput.
    21 (2009), 599-613, algorithm 1.
    """
    order = np.lexsort((intercepts, slopes))
    lines: list[tuple[float, float]] = []
    gives_way: list[float] = []
    for a, b in zip(intercepts[order].tolist(), slopes[order].tolist(), strict=True):
        while lines:
            last_a, last_b = lines[-1]
            if b > last_b:
                crossing = (last_a - a) / (b - last_b)
                if not gives_way or crossing > gives_way[-1]:
                    gives_way.append(crossing)
                    break
            # the last line is nowhere above both of its neighbours
            lines.pop()
            if gives_way:
                gives_way.pop()
        lines.append((a, b))
    steps = np.diff([b for _, b in lines])
    distance = -np.abs(gives_way)
    return float((steps * (norm.pdf(distance) + distance * norm.cdf(distance))).sum())


def knowledge_gradient(mean: Floats, response: Floats, observed_variance: Floats, noise_variance: Floats) -> Floats:
    """Return how much the best expected value is expected to rise when each candidate is observed once.

    Observing candidate j moves the expected values by response[:, j] / sqrt(v_j + n_j) times a standard normal.

    Parameters
    ----------
    mean : ndarray, shape (G,)
        Expected values among which the best is chosen.
    response : ndarray, shape (G, C)
        Covariance of each value with the quantity that candidate j observes.
    observed_variance, noise_variance : ndarray, shape (C,)
        Variance of that quantity before the observation, and of the observation itself.

    Returns
    -------
    ndarray, shape (C,)
        In the unit of the mean.
    """
    sd = np.sqrt(np.maximum(observed_variance, 0) + noise_variance)
    return np.array([expected_maximum_gain(mean, slopes) for slopes in (response / sd).T])


#: Standard uncertainty of the objective in a capture, where there is none to learn it from.
ASSUMED_CAPTURE_SD_REL = 0.01
#: A smaller expected rise of the objective is not worth an observation.
LEAST_GAIN_REL = 5e-4


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
    contact : int
        Number of the place to touch.
    """

    angle_deg: float
    gain_rel: float
    noise_rel: float
    contact: int = 0


def propose_render(decision: AngleDecision) -> Proposal | None:
    """Return the angle to render next, as many repeats as the sweep has; None where it would change nothing.

    Valid for repeats with the same draws as those of the sweep, so that they share its scale.
    """
    simulated = decision.simulated
    curve = simulated.posterior
    noise_rel = simulated.noise_rel / float(np.sqrt(simulated.repeats))
    noise_variance = np.full(curve.grid_deg.size, noise_rel**2)
    response = (decision.mean_rel / simulated.mean)[:, None] * curve.covariance
    choices = decision.choices
    mean = decision.mean_rel[choices]
    gains = knowledge_gradient(mean, response[choices], np.diag(curve.covariance), noise_variance)
    best = int(gains.argmax())
    gain_rel = float(gains[best] / mean.max())
    return None if gain_rel < LEAST_GAIN_REL else Proposal(float(curve.grid_deg[best]), gain_rel, noise_rel)


def propose_capture(decision: AngleDecision, captures: CaptureErrors) -> Proposal | None:
    """Return the place and the angle of the sweep to capture next; None where it would change nothing.

    A capture shows what captures of its kind see of the sim-to-real error at its place and angle (see `ErrorDraws`),
    with the noise of the captures so far (median; 1 % and 2 deg without any). How the value of each angle moves with
    that is taken from the joint draws, to first order; that a capture also tells the amplitude of the error is not
    counted.
    """
    sd_rel, angle_sd_deg = ASSUMED_CAPTURE_SD_REL, UNSTATED_ANGLE_SD_DEG
    if captures.names:
        sd_rel = float(np.sqrt(np.median(np.diag(captures.covariance))))
        angle_sd_deg = float(np.median(captures.angle_sd_deg))
    shown, choices = decision.shown_by_capture, decision.choices
    places, angles, _ = shown.shape
    swept_deg = decision.simulated.posterior.seen.angles_deg
    slopes = [np.interp(swept_deg, decision.grid_deg, curve.log_slope_per_deg) for curve in decision.curves]
    noise_variance = sd_rel**2 + (np.ravel(slopes) * angle_sd_deg) ** 2
    flat = shown.reshape(places * angles, -1)
    mean = decision.value_mean[choices]
    gains = knowledge_gradient(mean, flat[:, :-1][:, choices].T, flat[:, -1], noise_variance)
    best = int(gains.argmax())
    gain_rel = float(gains[best] / mean.max())
    if gain_rel < LEAST_GAIN_REL:
        return None
    place, angle = divmod(best, angles)
    return Proposal(float(swept_deg[angle]), gain_rel, float(np.sqrt(noise_variance[best])), place)
