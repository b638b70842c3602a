"""Teach a small network depth from a data set of 'finray study dataset', and judge it on presses that it has not seen.

    python learn_depth.py TRAIN [TEST] [--picture depth.png]

TRAIN and TEST are folders of data sets of the same finger; without TEST the part "test" of TRAIN judges. Needed are
numpy, scipy and OpenCV; matplotlib for the picture.

The network sees one cell of the pad: the pictures' colours there, sharp and blurred, and its place. It answers with the
two slopes of the depth, which are integrated by least squares (Frankot and Chellappa, 1988) with a pull to depth 0:
slopes say nothing of slow waves across the pad, and away from a contact the coat has not moved. The reach of that pull
is the one that is best on the training set's validation presses. The trivial answer beside it is the mean depth of all
training presses at each place.
"""

import argparse
import itertools
import json
import tarfile
from pathlib import Path

import cv2
import numpy as np
from scipy.fft import dctn, idctn
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import gaussian_filter, map_coordinates

CELL_MM = 0.7
BLURS_CELLS = (1.0, 3.0)
HIDDEN = 32
SAMPLES_PER_PICTURE = 1200
EPOCHS = 25
BATCH = 512
RATE = 3e-3
REACHES_MM = (2.5, 3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 40.0, 1000.0)


class Pad:
    """The pad at rest as a grid of square cells (across, along), and where in the picture each is seen."""

    def __init__(self, folder):
        places = np.load(folder / "places_mm.npy")
        seen = np.isfinite(places).all(axis=-1)
        low, high = places[seen].min(axis=0), places[seen].max(axis=0)
        self.x, self.z = (np.arange(a + CELL_MM / 2, b, CELL_MM) for a, b in zip(low, high, strict=True))
        wanted = np.stack(np.meshgrid(self.x, self.z, indexing="ij"), axis=-1)
        pixel = LinearNDInterpolator(places[seen], np.argwhere(seen).astype(float))(wanted)
        self.seen = np.isfinite(pixel).all(axis=-1)
        self.at = np.nan_to_num(np.moveaxis(pixel, -1, 0))
        self.place = wanted / np.abs(wanted).max(axis=(0, 1))

    def rectified(self, image):
        """Return an image (rows, columns, ...) on the cells."""
        planes = image.reshape(*image.shape[:2], -1)
        cells = [map_coordinates(planes[..., k], self.at, order=1, mode="nearest") for k in range(planes.shape[-1])]
        return np.stack(cells, axis=-1).reshape(*self.seen.shape, *image.shape[2:])


def samples(folder, split=None):
    """Yield labels and files of each sample of a part, by the rules of WebDataset."""
    for shard in sorted((folder / "shards").glob("shard-*.tar")):
        found = {}
        with tarfile.open(shard) as archive:
            for member in archive:
                key, _, ending = member.name.partition(".")
                found.setdefault(key, {})[ending] = archive.extractfile(member).read()
        for files in found.values():
            labels = json.loads(files["json"])
            if split is None or labels["split"] == split:
                yield labels, files


def picture(content):
    """Return a stored PNG as numbers, red first."""
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED).astype(np.float64)
    return image if image.ndim == 2 else image[..., ::-1]


def linear(srgb):
    """Return linear light of sRGB of 8 bit."""
    share = srgb / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def features(pad, files):
    """Return what the network sees of each cell, (across, along, feature)."""
    contact, rest = (linear(pad.rectified(picture(files[name]))) for name in ("rgb.png", "rest.png"))
    change = np.log(np.maximum(contact, 1e-3) / np.maximum(rest, 1e-3))
    blurred = [gaussian_filter(change, (sigma, sigma, 0)) for sigma in BLURS_CELLS]
    light = np.log(np.maximum(gaussian_filter(rest, (3.0, 3.0, 0)), 1e-3))
    return np.concatenate([change, *blurred, light, pad.place], axis=-1)


def truth(pad, files):
    """Return slopes (across, along, 2) and depth in mm (across, along) on the cells."""
    normal = (picture(files["normals.png"]) - 1.0) / 32767.0 - 1.0
    depth = picture(files["depth.png"])
    missing = depth == 0
    slopes = normal[..., [0, 2]] / np.where(missing, 1.0, normal[..., 1])[..., None]
    depth_mm = np.where(missing, 0.0, (depth - 32768.0) / 1000.0)
    return pad.rectified(np.where(missing[..., None], 0.0, slopes)), pad.rectified(depth_mm)


def integrated(slopes, reach_mm):
    """Return the depth (mm) that has the least sum of squares of its slopes' errors and of depth over reach.

    It is mirrored at the edges.
    """
    v, w = np.meshgrid(*(2.0 * np.sin(np.pi * np.arange(n) / (2.0 * n)) for n in slopes.shape[:2]), indexing="ij")
    # divergence of slopes between neighbours, with none over the edges
    steps = [
        CELL_MM * 0.5 * (slopes[1:, :, 0] + slopes[:-1, :, 0]),
        CELL_MM * 0.5 * (slopes[:, 1:, 1] + slopes[:, :-1, 1]),
    ]
    flow = np.diff(np.pad(steps[0], ((1, 1), (0, 0))), axis=0) + np.diff(np.pad(steps[1], ((0, 0), (1, 1))), axis=1)
    power = v**2 + w**2 + (CELL_MM / reach_mm) ** 2
    return idctn(-dctn(flow, norm="ortho") / power, norm="ortho")


class Network:
    """Two hidden layers of rectified units, trained by Adam on squared errors."""

    def __init__(self, sizes, rng):
        self.weights = [rng.normal(0.0, np.sqrt(2.0 / a), (a, b)) for a, b in itertools.pairwise(sizes)]
        self.biases = [np.zeros(b) for b in sizes[1:]]

    def layers(self, inputs):
        """Return the values of all layers."""
        values = [inputs]
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            sums = values[-1] @ weight + bias
            values.append(sums if k == len(self.weights) - 1 else np.maximum(sums, 0.0))
        return values

    def train(self, inputs, wanted, rng):
        """Fit the weights; the rate falls to nothing along a half cosine."""
        parts = [*self.weights, *self.biases]
        first, second = [np.zeros_like(p) for p in parts], [np.zeros_like(p) for p in parts]
        steps, step = EPOCHS * (len(inputs) // BATCH), 0
        for _ in range(EPOCHS):
            order = rng.permutation(len(inputs))
            for chosen in np.split(order[: len(order) // BATCH * BATCH], len(order) // BATCH):
                step += 1
                rate = RATE * 0.5 * (1.0 + np.cos(np.pi * step / steps))
                for k, gradient in enumerate(self.gradients(inputs[chosen], wanted[chosen])):
                    first[k] += 0.1 * (gradient - first[k])
                    second[k] += 0.001 * (gradient**2 - second[k])
                    mean, square = first[k] / (1.0 - 0.9**step), second[k] / (1.0 - 0.999**step)
                    parts[k] -= rate * mean / (np.sqrt(square) + 1e-8)

    def gradients(self, inputs, wanted):
        """Return the gradients of the mean squared error by weights, then by biases."""
        values = self.layers(inputs)
        error = 2.0 * (values[-1] - wanted) / len(inputs)
        of_weights, of_biases = [], []
        for k in reversed(range(len(self.weights))):
            of_weights.insert(0, values[k].T @ error)
            of_biases.insert(0, error.sum(axis=0))
            error = (error @ self.weights[k].T) * (values[k] > 0.0)
        return [*of_weights, *of_biases]


def taught(pad, folder, rng):
    """Return what predicts slopes from features, and the mean depth of the training presses."""
    inputs, wanted, depths = [], [], []
    for _, files in samples(folder, "train"):
        seen, (slopes, depth) = features(pad, files), truth(pad, files)
        # half of the cells from where the coat is tilted most: it is flat nearly everywhere
        steep = np.hypot(*np.moveaxis(slopes, -1, 0)) * pad.seen
        cells = np.concatenate([
            rng.choice(steep.size, SAMPLES_PER_PICTURE // 2, p=pad.seen.ravel() / pad.seen.sum()),
            rng.choice(steep.size, SAMPLES_PER_PICTURE // 2, p=steep.ravel() / steep.sum()),
        ])  # fmt: skip
        inputs.append(seen.reshape(steep.size, -1)[cells])
        wanted.append(slopes.reshape(steep.size, 2)[cells])
        depths.append(depth)
    inputs, wanted = np.concatenate(inputs), np.concatenate(wanted)
    centre, scale = inputs.mean(axis=0), inputs.std(axis=0)
    size = wanted.std()
    network = Network([inputs.shape[1], HIDDEN, HIDDEN, 2], rng)
    network.train((inputs - centre) / scale, wanted / size, rng)
    return lambda seen: size * network.layers((seen - centre) / scale)[-1], np.mean(depths, axis=0)


def answered(pad, predict, judge):
    """Return of each sample the press, the depth and the predicted slopes on the cells."""
    return [
        (labels["press"], truth(pad, files)[1], np.where(pad.seen[..., None], predict(features(pad, files)), 0.0))
        for labels, files in judge
    ]


def best_reach_mm(pad, answers):
    """Return the reach of the pull to depth 0 with the least squared error."""
    return min(
        REACHES_MM,
        key=lambda reach: sum(np.sum((integrated(s, reach) - d)[pad.seen] ** 2) for _, d, s in answers),
    )


def judged(pad, answers, reach_mm, trivial_mm):
    """Return by press the rms error of depth over the seen pad of network and trivial answer, mm; and the depths."""
    errors, shown = {}, []
    for press, depth, slopes in answers:
        found = integrated(slopes, reach_mm)
        rms = [np.sqrt(np.mean((answer - depth)[pad.seen] ** 2)) for answer in (found, trivial_mm)]
        errors.setdefault(press, []).append(rms)
        shown.append((press, depth, found))
    return {press: np.mean(pairs, axis=0) for press, pairs in errors.items()}, shown


def interval95(both, of, rng):
    """Return the 95 % limits of a number of the presses' errors (press, answer) by the bootstrap over presses."""
    chosen = rng.integers(len(both), size=(4000, len(both)))
    return np.percentile([of(both[rows].mean(axis=0)) for rows in chosen], (2.5, 97.5))


def draw(path, shown, pad):
    """Draw truth, answer and difference of four presses."""
    from matplotlib.figure import Figure

    chosen = list({press: rest for press, *rest in shown}.items())[:4]
    figure = Figure(figsize=(9.0, 1.7 * len(chosen) + 0.5), layout="constrained")
    axes = figure.subplots(len(chosen), 3, squeeze=False, sharex=True, sharey=True)
    for row, (press, (depth, found)) in zip(axes, chosen, strict=True):
        limit = float(np.abs(depth).max())
        for axis, values, title in zip(
            row, (depth, found, found - depth), ("rendered", "network", "difference"), strict=True
        ):
            held = np.where(pad.seen, values, np.nan)
            drawn = axis.imshow(held, extent=(pad.z[0], pad.z[-1], pad.x[0], pad.x[-1]), origin="lower", cmap="RdBu_r",
                                vmin=-limit, vmax=limit)  # fmt: skip
            axis.set_title(f"press {press}, {title}", fontsize=8)
        figure.colorbar(drawn, ax=row, label="depth, mm")
    for axis in axes[-1]:
        axis.set_xlabel("along the pad, mm")
    figure.savefig(path, dpi=110)


def main():
    """Teach, judge, tell."""
    parser = argparse.ArgumentParser(description="Teach a small network depth, and judge it on unseen presses.")
    parser.add_argument("train", type=Path)
    parser.add_argument("test", type=Path, nargs="?")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    rng = np.random.default_rng(1)
    pad = Pad(given.train)
    predict, trivial_mm = taught(pad, given.train, rng)
    validation = answered(pad, predict, samples(given.train, "validation"))
    reach_mm = best_reach_mm(pad, validation) if validation else REACHES_MM[-1]
    print(f"reach of the pull to depth 0: {reach_mm:g} mm, by {len({press for press, *_ in validation})} presses")
    judge = samples(given.train, "test") if given.test is None else samples(given.test)
    errors, shown = judged(pad, answered(pad, predict, judge), reach_mm, trivial_mm)
    both = np.array(list(errors.values()))
    for name, of in (
        ("network: rms error of depth, mm", lambda mean: mean[0]),
        ("mean depth of the training presses: rms error of depth, mm", lambda mean: mean[1]),
        ("network over mean depth", lambda mean: mean[0] / mean[1]),
    ):
        low, high = interval95(both, of, rng)
        print(f"{name}: {of(both.mean(axis=0)):.4f}, 95 % [{low:.4f}, {high:.4f}], {len(both)} presses")
    if given.picture is not None:
        draw(given.picture, shown, pad)


if __name__ == "__main__":
    main()
