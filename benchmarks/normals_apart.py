"""Whether the angle decided by the error of the sensed normal is the best by another way to read normals.

    python -m benchmarks.normals_apart --red RED --green GREEN [--design flat-70x35] [--decided -25 10]

The decision exposes, adds noise, fits a cubic polynomial from colour and place to slopes and holds places out in turn.
All of that is done otherwise here. Light is traced at each angle by itself, chain by chain of fluorescence, in place of
all angles together; there are 15 rows of 5 places in place of 6; normals are read by kernel ridge regression that has
not seen the row; a repeat has other paths, paint draws and noise. Shared are the scene and the paths to facets of the
coat: a wrong radiance of a facet is not found here (`tests/simulate/test_light_angle_objectives.py` compares facets
with a tilted coat).

With --predictions, the objective itself is compared with what another way to read normals reaches: 49 facets of a ball
at 63 places, other paths, exposure and noise by numpy, and the mean slope of the 12 nearest colours and places of other
places, in place of a polynomial. Shown are the mean errors, their ratio to those predicted, and the rank correlation
over the angles. Facets without shadows and without light from their neighbours are shared.

Values are inverse errors over those of the best angle of each row, at traced angles only; the standard error is of the
repeats. Returns 1 where a value is below 0.99 of the best by more than two standard errors; with --predictions, where a
ratio or the rank correlation is outside its limits.
"""

import argparse
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

from data_schemas import FingerDesign, PaintCalibration
from data_schemas.storage import camera_response, read_record
from sim import given_design
from sim.experiments import EvaluationSettings, FingerEvaluator, PaintDraws, _finger_evaluation
from sim.experiments._light_angle import angle_objectives, facet_slopes
from sim.experiments._painted_finger import PaintedFinger, paint_finger, paint_optics
from sim.optics import (
    ProbePaths,
    check_paints,
    choose_variant,
    measure_together,
    open_renderer,
    seen_points,
    tilted_facets,
    with_light_angle,
)
from sim.surface_meshes import rest_shape

Floats = NDArray[np.float64]

LEAST_SHARE = 0.99
ANGLES_DEG = (-60.0, -45.0, -35.0, -25.0, -15.0, -5.0, 10.0, 20.0, 35.0, 60.0, 100.0)
ROWS, FOLDS = 15, 5
FULL_WELL_E, READ_NOISE_E, CLIPPED_SHARE = 5000.0, 4.0, 1e-3
#: Lengths of the kernel in standard deviations of the colours and of the places, and its noise.
COLOUR_LENGTH, PLACE_LENGTH, RIDGE = 1.5, 1.5, 0.01
#: Facets of a ball's cap, tilted by up to as much as those of the objective, and what is near: relative colour, mm.
CAP_DEG, CAP_FACETS, NEAREST = 20.0, 48, 12
NEAR_COLOUR_REL, NEAR_MM = 0.08, (6.0, 12.0)
FRAMES, PLACE_FOLDS = 4, 7
#: A factor common to all angles changes no choice: another map, and a cap with larger tilts on average (13 in place of
#: 11 deg), may make a quarter. Neighbouring angles differ by less than the noise of two repeats: ranks differ a little.
RATIOS, LEAST_RANK_CORRELATION = (0.8, 1.25), 0.8


def main() -> int:
    """Trace, read normals, compare, and print a line for each way to weigh the places."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--red", type=Path, required=True)
    parser.add_argument("--green", type=Path, required=True)
    parser.add_argument("--design", type=Path, default=Path("flat-70x35"))
    parser.add_argument("--decided", type=float, nargs=2, default=(-25.0, 10.0), metavar=("AVERAGE", "WORST"))
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--predictions", action="store_true", help="compare the objective with what is reached")
    arguments = parser.parse_args()
    design, _, folder = given_design(arguments.design)
    paints = {c: PaintDraws.of(read_record(getattr(arguments, c), PaintCalibration)) for c in ("red", "green")}
    renderer, response = open_renderer(choose_variant("llvm"), 1), camera_response(design.camera.response, folder)
    if arguments.predictions:
        fits = {c: paint_optics(read_record(getattr(arguments, c), PaintCalibration)) for c in ("red", "green")}
        return int(not compare_predictions(paint_finger(design, fits, folder, renderer), arguments.repeats))
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


def compare_predictions(finger: PaintedFinger, repeats: int) -> bool:
    """Print predicted errors of the normal beside those that nearest neighbours reach; return whether they agree."""
    bands = check_paints(finger.design, finger.paints)
    to_camera = finger.camera_matrix(bands)
    predicted = next(
        objective.values.mean(axis=1)
        for objective in angle_objectives(finger, np.array([to_camera] * repeats), ANGLES_DEG, 3)[0]
        if objective.name == "held-out normal error"
    )
    rest = rest_shape(finger.design)
    points = seen_points(finger.design, rest, finger.renderer, 7, 9, None)
    slopes = slopes_of_cap(np.random.default_rng(5))
    designs = [with_light_angle(finger.design, angle) for angle in ANGLES_DEG]
    facets = tilted_facets(points.normals, slopes)
    paths = ProbePaths(4096, repeats, 900)
    basis = measure_together(designs, rest, bands, finger.renderer, points.probes, facets, paths, None)
    rgb = np.einsum("cb,arfpb->arpfc", to_camera, basis)
    reached = np.empty(rgb.shape[:2])
    for angle, repeat in np.ndindex(*reached.shape):
        reached[angle, repeat] = nearest_error_deg(rgb[angle, repeat], points.places_mm, slopes, [angle, repeat])
    ratio, order = reached.mean(axis=1) / predicted, float(spearmanr(reached.mean(axis=1), predicted)[0])
    for row in zip(ANGLES_DEG, predicted, reached.mean(axis=1), ratio, np.ptp(reached, axis=1), strict=True):
        print(
            "{:5g} deg: predicted {:.2f} deg, reached {:.2f} deg, ratio {:.3f}; repeats {:.2f} deg apart".format(*row)
        )
    print(f"ratios {ratio.min():.3f} to {ratio.max():.3f}, rank correlation {order:.2f}")
    return bool(RATIOS[0] <= ratio.min() and ratio.max() <= RATIOS[1] and order >= LEAST_RANK_CORRELATION)


def slopes_of_cap(rng: np.random.Generator) -> Floats:
    """Return slopes of facets (facet, 2), the first without tilt, the others spread evenly over a ball's cap."""
    size, turn = np.tan(np.radians(CAP_DEG)) * np.sqrt(rng.random(CAP_FACETS)), rng.uniform(0, 2 * np.pi, CAP_FACETS)
    return np.concatenate([np.zeros((1, 2)), np.column_stack([size * np.cos(turn), size * np.sin(turn)])])


def nearest_error_deg(rgb: Floats, places_mm: Floats, slopes: Floats, seed: list[int]) -> float:
    """Return the mean error of normals read from radiances (point, facet, 3) by the nearest of other places."""
    rng = np.random.default_rng(seed)
    signal_e = rgb * (FULL_WELL_E / np.quantile(rgb.max(axis=-1), 1.0 - CLIPPED_SHARE))
    frames_e = np.repeat(signal_e[:, :, None], FRAMES, axis=2)
    seen_e = np.minimum(rng.poisson(frames_e) + rng.normal(0.0, READ_NOISE_E, frames_e.shape), FULL_WELL_E)
    colour = seen_e / signal_e[:, :1, None] / NEAR_COLOUR_REL
    place = np.broadcast_to((places_mm / NEAR_MM)[:, None, None], (*colour.shape[:3], 2))
    inputs, truth = np.concatenate([colour, place], axis=-1), np.broadcast_to(slopes[None, :, None], place.shape)
    fold, errors_deg = np.random.default_rng(1).permutation(len(places_mm)) % PLACE_FOLDS, []
    for held_out in range(PLACE_FOLDS):
        own, others = fold == held_out, fold != held_out
        distance, near = cKDTree(inputs[others].reshape(-1, 5)).query(inputs[own].reshape(-1, 5), NEAREST)
        weight = 1.0 / (distance + 0.3)  # equal neighbours in noise, which is some 0.2 of the units above
        read = (weight[..., None] * truth[others].reshape(-1, 2)[near]).sum(axis=1) / weight.sum(axis=1)[:, None]
        errors_deg.append(angle_deg_between(read, truth[own].reshape(-1, 2)))
    return float(np.concatenate(errors_deg).mean())


if __name__ == "__main__":
    sys.exit(main())
