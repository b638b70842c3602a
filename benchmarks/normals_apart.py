"""Whether the angle decided by the error of the sensed normal is the best by another way to read normals.

    python -m benchmarks.normals_apart --red RED --green GREEN [--design flat-70x35] [--decided -25 10]

The decision exposes, adds noise, fits a cubic polynomial from colour and place to slopes and holds places out in turn.
All of that is done otherwise here. Light is traced at each angle by itself, chain by chain of fluorescence, in place of
all angles together; there are 15 rows of 5 places in place of 6; normals are read by kernel ridge regression that has
not seen the row; a repeat has other paths, paint draws and noise. Shared are the scene and the paths to facets of the
coat: a wrong radiance of a facet is not found here (`tests/simulate/test_light_angle_objectives.py` compares facets
with a tilted coat).

Values are inverse errors over those of the best angle of each row, at traced angles only; the standard error is of the
repeats. Returns 1 where a value is below 0.99 of the best by more than two standard errors.
"""

import argparse
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, PaintCalibration
from data_schemas.storage import camera_response, read_record
from sim import given_design
from sim.experiments import EvaluationSettings, FingerEvaluator, PaintDraws, _finger_evaluation
from sim.experiments._light_angle import facet_slopes
from sim.optics import choose_variant, open_renderer, with_light_angle

Floats = NDArray[np.float64]

LEAST_SHARE = 0.99
ANGLES_DEG = (-60.0, -45.0, -35.0, -25.0, -15.0, -5.0, 10.0, 20.0, 35.0, 60.0, 100.0)
ROWS, FOLDS = 15, 5
FULL_WELL_E, READ_NOISE_E, CLIPPED_SHARE = 5000.0, 4.0, 1e-3
#: Lengths of the kernel in standard deviations of the colours and of the places, and its noise.
COLOUR_LENGTH, PLACE_LENGTH, RIDGE = 1.5, 1.5, 0.01


def main() -> int:
    """Trace, read normals, compare, and print a line for each way to weigh the places."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--red", type=Path, required=True)
    parser.add_argument("--green", type=Path, required=True)
    parser.add_argument("--design", type=Path, default=Path("flat-70x35"))
    parser.add_argument("--decided", type=float, nargs=2, default=(-25.0, 10.0), metavar=("AVERAGE", "WORST"))
    parser.add_argument("--repeats", type=int, default=2)
    arguments = parser.parse_args()
    design, _, folder = given_design(arguments.design)
    paints = {c: PaintDraws.of(read_record(getattr(arguments, c), PaintCalibration)) for c in ("red", "green")}
    renderer, response = open_renderer(choose_variant("llvm"), 1), camera_response(design.camera.response, folder)
    errors_deg = np.empty((arguments.repeats, len(ANGLES_DEG), ROWS))
    with patch.object(_finger_evaluation, "POINTS_ALONG", ROWS):
        for repeat in range(arguments.repeats):
            evaluator = FingerEvaluator(response, renderer, EvaluationSettings(draws=2, seed=70 + repeat))
            for k, angle in enumerate(ANGLES_DEG):
                errors_deg[repeat, k] = errors_of_rows(evaluator, with_light_angle(design, angle), paints, repeat)
    for k, angle in enumerate(ANGLES_DEG):
        each = ", ".join(f"{one:.2f}" for one in errors_deg[:, k].mean(axis=1))
        print(f"{angle:5g} deg: error of the normal {errors_deg[:, k].mean():.2f} deg (repeats {each})")
    shares = [compare(*given, errors_deg) for given in zip(("average", "worst"), arguments.decided, strict=True)]
    return int(any(share + 2.0 * error < LEAST_SHARE for share, error in shares))


def errors_of_rows(
    evaluator: FingerEvaluator, design: FingerDesign, paints: dict[str, PaintDraws], seed: int
) -> Floats:
    """Return the mean error of the normal of each row of places, (row,), in deg."""
    table = evaluator.evaluate(design, paints).table  # its exposure is replaced
    places_mm, slopes = table.places_mm, facet_slopes()
    row = np.searchsorted(
        np.linspace(places_mm[:, 1].min(), places_mm[:, 1].max(), 2 * ROWS - 1)[1::2], places_mm[:, 1]
    )
    found = []
    for draw, rgb in enumerate(table.signal_e[0]):  # (point, facet, 3)
        rng = np.random.default_rng([seed, draw])
        signal_e = rgb * (FULL_WELL_E / np.quantile(rgb.max(axis=-1), 1.0 - CLIPPED_SHARE))
        seen_e = rng.poisson(signal_e) + rng.normal(0.0, READ_NOISE_E, signal_e.shape)
        colour = np.minimum(seen_e, FULL_WELL_E) / signal_e[:, :1]
        place = np.broadcast_to(places_mm[:, None], (*colour.shape[:2], 2))
        inputs, truth = np.concatenate([colour, place], axis=-1), np.broadcast_to(slopes, place.shape)
        error_deg = np.empty(len(places_mm))
        for fold in range(FOLDS):
            own, others = row % FOLDS == fold, row % FOLDS != fold
            taught, at = inputs[others].reshape(-1, 5), inputs[own].reshape(-1, 5)
            read = kernel_ridge(taught, truth[others].reshape(-1, 2), at)
            angle = angle_deg_between(read, truth[own].reshape(-1, 2))
            error_deg[own] = angle.reshape(own.sum(), -1).mean(axis=1)
        found.append([error_deg[row == k].mean() for k in range(ROWS)])
    return np.mean(found, axis=0)


def kernel_ridge(taught: Floats, values: Floats, at: Floats) -> Floats:
    """Return the values (M, 2) at inputs (M, 5) of kernel ridge regression with a Gaussian kernel."""
    lengths = taught.std(axis=0) * ([COLOUR_LENGTH] * 3 + [PLACE_LENGTH] * 2)

    def kernel(one: Floats) -> Floats:
        apart = ((one[:, None] - taught) / lengths) ** 2
        return np.asarray(np.exp(-0.5 * apart.sum(axis=-1)))

    weights = np.linalg.solve(kernel(taught) + RIDGE * np.eye(len(taught)), values)
    return np.asarray(kernel(at) @ weights)


def angle_deg_between(slopes: Floats, others: Floats) -> Floats:
    """Return the angles between the normals of slopes (N, 2), in deg."""
    first, second = (np.column_stack([one, np.ones(len(one))]) for one in (slopes, others))
    cosine = (first * second).sum(axis=1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def compare(criterion: str, decided_deg: float, errors_deg: Floats) -> tuple[float, float]:
    """Print and return the value of the decided angle over that of the best one, and its standard error."""
    nearest = int(np.abs(np.array(ANGLES_DEG) - decided_deg).argmin())

    def values(errors: Floats) -> Floats:
        relative = errors.min(axis=0) / errors
        return np.asarray(relative.mean(axis=1) if criterion == "average" else relative.min(axis=1))

    value = values(errors_deg.mean(axis=0))
    best = int(value.argmax())
    each = [values(one)[nearest] / values(one)[best] for one in errors_deg]
    share, error = float(value[nearest] / value[best]), float(np.std(each, ddof=1) / np.sqrt(len(each)))
    print(
        f"{ROWS} rows, {criterion}: decided {decided_deg:g} deg; at {ANGLES_DEG[nearest]:g} deg {value[nearest]:.4f}, "
        f"best {value[best]:.4f} at {ANGLES_DEG[best]:g} deg: {share:.3f} +- {error:.3f} of it "
        f"(at least {LEAST_SHARE}): {'met' if share >= LEAST_SHARE else 'NOT MET'}"
    )
    return share, error


if __name__ == "__main__":
    sys.exit(main())
