"""A finger that answers presses in milliseconds, with error bars: taught by a few presses by finite elements.

The contact is found on the finger condensed to its coat (:class:`~sim.mechanics.CondensedFinger`). What that leaves,
large strains of the gel and bending of the ribs, does not travel with the contact; Gaussian processes learn it from
presses that are chosen where they know least. The bars are as wide as presses that were left out ask for.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import Bounds, minimize
from scipy.spatial import cKDTree
from scipy.stats import qmc

from data_schemas import (
    FingerDesign,
    FingerSurfaces,
    Indenter,
    Preset,
    PressFamily,
    PressSurrogate,
    SimulateError,
    SurrogateBars,
    TaughtKernel,
    TaughtPress,
)
from sim.mechanics import (
    Condensation,
    CondensedContact,
    CondensedFinger,
    PressedFinger,
    PressSettings,
    condense_finger,
    contact_distance,
    press_finger,
    rigid_indenter,
)
from sim.surface_meshes import shape_from_mesh, store_shapes

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Progress = Callable[[int, int, str], None]

LEVEL: Final = 0.95
LIMIT_REL: Final = 0.1
"""A bar over the force, or over the surface's own displacement, from which finite elements should press instead."""
FEWEST_PRESSES: Final = 20
"""With fewer, presses left out have too few neighbours to tell how wide the bars must be."""
DEFAULT_PRESSES: Final = 40

_EVENLY = 12  # presses spread evenly; each further one is chosen where least is known
_SETTLED_REL = 1e-3  # to which a contact is found: no bar is less
_POOL = 256  # presses that the next one is chosen from
_PUSH = (3.0 / 4.0, 1.0)  # of the deepest: presses that teach end between, and pass all smaller pushes
_INCREMENTS = 4
_MOST_MODES = 40
_RELEARN = 4  # presses between two searches of the kernels
_SAME_NODE_MM = 1e-6
_LENGTHS = (0.2, 20.0)  # in half widths of the family
_LINEAR = (1e-4, 1e2)
_NOISE = (1e-7, 1e-1)
_JITTER = 1e-9
_ASKED = 1024  # presses, for which bars shall be narrow
_FLOORS = np.array([0.01, 0.03, 0.1, 0.3, 1.0])  # of the median deviation of presses left out
_FEATURES = 6
_MIRRORED = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0])  # features across the finger's middle
# of a design, what no press by finite elements reads
_UNREAD = frozenset(
    {"indenter", "provenance", "name", "origin", "uncertainty_rel", "materials", "coating", "light", "second_light",
     "further_lights"}
)  # fmt: skip


def press_family(design: FingerDesign) -> PressFamily:
    """Return the presses that a surrogate of a finger answers, by the size of its pad.

    Places along the middle 65 % of the pad, and 17 % of its width to each side: nearer to its ends the indenter
    overhangs. Radii of 6 to 20 mm, which several elements of the coarse coat touch; pushes up to 4 mm.
    """
    length, width = design.pad.length_mm, design.pad.width_mm
    return PressFamily(
        radius_mm=(6.0, 20.0),
        position_mm=(0.2 * length, 0.85 * length),
        across_mm=(-6.0 / 35.0 * width, 6.0 / 35.0 * width),
        turn_deg=(-30.0, 30.0),
        depth_mm=(0.5, 4.0),
    )


def candidate_presses(family: PressFamily, count: int = _POOL) -> list[Indenter]:
    """Return presses spread evenly over half of a family (Sobol's sequence); the other half mirrors them."""

    def between(share: float, bounds: tuple[float, float]) -> float:
        return float(bounds[0] + share * (bounds[1] - bounds[0]))

    found, (small, large), whole = [], family.radius_mm, 1 << (count - 1).bit_length()
    for along, across, size, turn, shape, push in qmc.Sobol(_FEATURES, seed=1).random(whole)[:count]:
        cylinder = shape < 1.0 / 2.0
        found.append(
            Indenter(
                shape="cylinder" if cylinder else "ball",
                radius_mm=float(small * (large / small) ** size),
                position_mm=between(along, family.position_mm),
                across_mm=between(across, (0.0, family.across_mm[1])),
                rotation_deg=(0.0, between(turn, family.turn_deg) if cylinder else 0.0, 0.0),
                depth_mm=family.depth_mm[1] * between(push, _PUSH),
            )
        )
    return found


@dataclass(frozen=True, slots=True)
class Process:
    """A Gaussian process at its samples: weights of the samples at a place, and its standard deviation there."""

    kernel: TaughtKernel
    samples: Floats  # (s, d)

    @property
    def matrix(self) -> Floats:
        """Covariance of the samples (s, s) with their noise, over the variance."""
        return self.between(self.samples) + (self.kernel.noise_rel + _JITTER) * np.eye(len(self.samples))

    def between(self, places: Floats) -> Floats:
        """Return the covariance (q, s) of places with the samples, over the variance."""
        return _covariance(places, self.samples, self.kernel.lengths, self.kernel.linear_rel)

    def at_themselves(self, places: Floats) -> Floats:
        """Return the variance (q,) of places before anything is known, over the variance."""
        return np.asarray(1.0 + self.kernel.linear_rel * (1.0 + (places**2).sum(axis=1)))


def _covariance(first: Floats, second: Floats, lengths: Floats, linear_rel: float) -> Floats:
    """Return exp(-d^2 / 2) + linear_rel (1 + x . y) of two sets of places."""
    a, b = first / lengths, second / lengths
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0.0)) + linear_rel * (1.0 + first @ second.T))


def likeliest_kernel(samples: Floats, products: Floats) -> TaughtKernel:
    """Return the kernel of greatest likelihood for values with these products (s, s) among each other.

    So is the variance, one for all components; a weak prior holds lengths near two half widths.
    """
    count, width = samples.shape
    scale = float(np.trace(products)) / count

    def taught(parameters: Floats) -> tuple[float, TaughtKernel]:
        lengths, (linear, noise) = np.exp(parameters[:width]), np.exp(parameters[width:])
        kernel = TaughtKernel(lengths=lengths, linear_rel=float(linear), noise_rel=float(noise), variance_rel=1.0)
        factor = cho_factor(Process(kernel, samples).matrix, lower=True)
        variance = float(np.trace(cho_solve(factor, products / scale))) / count
        misfit = 0.5 * count * np.log(variance) + float(np.log(np.diag(factor[0])).sum())
        misfit += 0.5 * float(((parameters[:width] - np.log(2.0)) ** 2).sum())
        return misfit, kernel.model_copy(update={"variance_rel": variance * scale})

    start: Floats = np.log(np.array([2.0] * width + [1.0, 1e-4]))
    limits = Bounds(*np.log(np.array([*[_LENGTHS] * width, _LINEAR, _NOISE])).T)

    def misfit_of(parameters: Floats) -> float:
        return taught(parameters)[0]

    return taught(minimize(misfit_of, start, method="L-BFGS-B", bounds=limits, options={"maxiter": 40}).x)[1]


@dataclass(frozen=True, slots=True)
class Samples:
    """Increments of the presses that teach, and their mirror images, s in all."""

    press: Integers  # (s,)
    features: Floats  # (s, d)
    rest_rel: NDArray[np.float32]  # (s, 3 n), displacement that condensation leaves, over the push
    own_rel: Floats  # (s,), root mean square displacement of the coat over the push
    force_rest_rel: Floats  # (s, 3), force that condensation leaves over its force along the normal
    force_rel: Floats  # (s,), force over that of condensation
    crossed: Floats  # (c, d), features of increments that teach nothing

    def __len__(self) -> int:
        return len(self.press)


def mirror_images(nodes_mm: Floats) -> Integers:
    """Return the number of each node's mirror image across the finger's middle."""
    distance, image = cKDTree(nodes_mm).query(nodes_mm * np.array([-1.0, 1.0, 1.0]))
    if np.max(distance) > _SAME_NODE_MM:
        raise SimulateError("training a surrogate needs a mesh that is symmetric about x = 0, but this mesh is not")
    return np.asarray(image)


def samples_of(
    finger: CondensedFinger, family: PressFamily, image: Integers, number: int, press: TaughtPress
) -> Samples:
    """Return what one press by finite elements has beyond the condensed finger's; `image` is that of the nodes."""
    flip, indenter, rigid = np.array([-1.0, 1.0, 1.0]), press.design.indenter, rigid_indenter(press.design)
    rows: list[tuple[Floats, NDArray[np.float32], float, Floats, float]] = []
    crossed = [family.features(indenter)] if press.unreached else []
    for k, depth in enumerate(press.depth_mm.tolist()):
        features = family.features(indenter.model_copy(update={"depth_mm": depth}))
        if k >= press.sound:
            crossed.append(features)
            continue
        contact = finger.press(rigid, depth)
        rest = (press.displacement_mm[k] - finger.displacement_mm(contact)) / depth
        own = rms_length(press.displacement_mm[k][finger.coat]) / depth
        force = (press.force_n[k] - contact.force_n) / contact.force_n[1]
        for seen, field, left in ((features, rest, force), (features * _MIRRORED, rest[image] * flip, force * flip)):
            rows.append((seen, field.astype(np.float32).ravel(), own, left, 1.0 + float(force[1])))
    features_of, rests, owns, forces, times = zip(*rows, strict=True) if rows else ((),) * 5
    places = np.array(crossed).reshape(-1, _FEATURES)
    return Samples(
        np.full(len(rows), number),
        np.array(features_of).reshape(-1, _FEATURES),
        np.array(rests, np.float32).reshape(len(rows), finger.mesh.nodes_mm.size),
        np.array(owns),
        np.array(forces).reshape(-1, 3),
        np.array(times),
        np.concatenate([places, places * _MIRRORED]),
    )


def together(samples: Sequence[Samples]) -> Samples:
    """Return the samples of several presses as one."""
    whole = Samples(*(np.concatenate([getattr(s, field.name) for s in samples]) for field in fields(Samples)))
    if not len(whole):
        raise SimulateError("none of the presses can be used for training, because ribs intersect in every one of them")
    return whole


def rms_length(vectors: NDArray[np.floating]) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt((np.asarray(vectors, dtype=np.float64) ** 2).sum(axis=1).mean()))


def _left_out(process: Process, products: Floats, press: Integers) -> tuple[Floats, Floats]:
    """Return errors of predictions without a sample's own press, and their standard deviations, both (s,)."""
    inverse = np.linalg.inv(process.matrix)
    error, deviation = np.empty(len(press)), np.empty(len(press))
    for number in np.unique(press):
        own = np.flatnonzero(press == number)
        covariance = np.linalg.inv(inverse[np.ix_(own, own)])
        weights = covariance @ inverse[own]
        error[own] = np.sqrt(np.maximum(np.einsum("gs,st,gt->g", weights, products, weights), 0.0))
        deviation[own] = np.sqrt(np.diag(covariance) * process.kernel.variance_rel)
    return error, deviation


def _bar(process: Process, products: Floats, samples: Samples, asked: Floats) -> tuple[Floats, float, float]:
    """Return errors of presses left out, the conformal quantile of error / (deviation + floor), and the floor.

    Presses that teach were chosen where least is known, at the family's edges, and left out one by one they are known
    least of all: each of their increments counts by how many presses asked are nearest to it. Near what is known a
    process is surer of itself than its errors are small; the floor is the one whose bars are narrowest for what is
    asked. Of n presses the level is (n + 1) / n.
    """
    error, deviation = _left_out(process, products, samples.press)
    _, nearest = cKDTree(samples.features / process.kernel.lengths).query(asked / process.kernel.lengths)
    counts = np.bincount(nearest, minlength=len(samples))
    presses, own = len(np.unique(samples.press)), _deviation(process, asked)
    level, found = min(1.0, LEVEL * (presses + 1) / presses), []
    for floor in np.median(deviation) * _FLOORS:
        scores = error / (deviation + floor)
        order = np.argsort(scores)
        reached = np.searchsorted(np.cumsum(counts[order]), level * counts.sum())
        bar = float(scores[order[min(reached, len(order) - 1)]])
        found.append((bar * float(np.mean(own + floor)), bar, float(floor)))
    return error, *min(found)[1:]


@dataclass(frozen=True, slots=True)
class _Learned:
    """Both processes, and what the surfaces' samples have in common on the coat."""

    surface: Process
    force: Process
    surface_products: Floats
    force_products: Floats


def _learn(finger: CondensedFinger, samples: Samples, before: _Learned | None) -> _Learned:
    """Return the processes, with the kernels of before where there are any."""
    coat = samples.rest_rel.reshape(len(samples), -1, 3)[:, finger.coat].reshape(len(samples), -1).astype(np.float64)
    surface = coat @ coat.T / len(finger.coat)
    along = samples.force_rest_rel[:, 1]
    force = np.outer(along, along)
    if before is None:
        kernels = [likeliest_kernel(samples.features, products) for products in (surface, force)]
    else:
        kernels = [before.surface.kernel, before.force.kernel]
    processes = [Process(kernel, samples.features) for kernel in kernels]
    return _Learned(processes[0], processes[1], surface, force)


def _least_known(learned: _Learned, samples: Samples, family: PressFamily, left: Sequence[Indenter]) -> int:
    """Return which press both processes know least of, relative to surface and force."""
    places = np.array([family.features(indenter) for indenter in left])
    surface = _deviation(learned.surface, places) / float(np.median(samples.own_rel))
    return int(np.argmax(np.maximum(surface, _deviation(learned.force, places))))


def _deviation(process: Process, places: Floats) -> Floats:
    """Return the standard deviation (q,) at places, with the noise."""
    between = process.between(places)
    known = np.einsum("qs,sq->q", between, np.linalg.solve(process.matrix, between.T))
    spread = np.maximum(process.at_themselves(places) - known, 0.0) + process.kernel.noise_rel
    return np.asarray(np.sqrt(process.kernel.variance_rel * spread))


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """How a surrogate is taught.

    Attributes
    ----------
    presses
        By finite elements, at least 20; those after the first 12 are chosen where the processes know least.
    preset, threads
        Fineness of the mesh, the design's own by default; threads of elements and factorisation.
    """

    presses: int = DEFAULT_PRESSES
    preset: Preset | None = None
    threads: int = 1


def train_surrogate(
    design: FingerDesign,
    settings: TrainingSettings | None = None,
    *,
    stored: Callable[[int], TaughtPress | None] | None = None,
    store: Callable[[int, TaughtPress], None] | None = None,
    progress: Progress | None = None,
) -> PressSurrogate:
    """Condense a finger, press it by finite elements and learn what condensation leaves out.

    Valid for the family that :func:`press_family` states. The bars rest on presses left out one at a time, and hold for
    presses spread evenly over the family.

    Parameters
    ----------
    design, settings
        The finger, whose indenter has no part in it, and how it is taught.
    stored, store
        Returns press number k of an earlier run, or nothing; called with each new press and its number, to keep it.
    progress
        Called during condensation and each press.

    Raises
    ------
    SimulateError
        When there are too few presses, the finger cannot be meshed, or a stored press is another one.
    """
    settings, begun = settings or TrainingSettings(), time.process_time()
    if settings.presses < FEWEST_PRESSES:
        raise SimulateError(f"{settings.presses} presses are too few; give at least {FEWEST_PRESSES}")
    preset, family = settings.preset or design.mesh.preset, press_family(design)
    condensed = condense_finger(design, preset, settings.threads, progress)
    finger = CondensedFinger(design, preset, condensed)
    left = candidate_presses(family, max(_POOL, 2 * settings.presses))
    image = mirror_images(finger.mesh.nodes_mm)
    found: list[Samples] = []
    learned: _Learned | None = None
    seconds = 0.0
    while len(found) < settings.presses:
        number, which = len(found), 0
        if number >= _EVENLY:
            samples = together(found)
            relearn = learned is None or (number - _EVENLY) % _RELEARN == 0
            learned = _learn(finger, samples, None if relearn else learned)
            which = _least_known(learned, samples, family, left)
        wanted = design.model_copy(update={"indenter": left.pop(which), "provenance": None})
        before = None if stored is None else stored(number)
        press = before or press_to_teach(wanted, preset, settings, number, progress)
        _check_same_press(press, wanted, preset, number)
        if before is None and store is not None:
            store(number, press)
        seconds += press.processor_s if before is not None else 0.0
        found.append(samples_of(finger, family, image, number, press))
    samples = together(found)
    learned = _learn(finger, samples, None)
    return _surrogate(design, preset, family, condensed, samples, learned, time.process_time() - begun + seconds)


def _differs(one: FingerDesign, other: FingerDesign) -> list[str]:
    """Return in which fields two fingers differ, apart from their indenters and what no press reads."""
    fields = [name for name in FingerDesign.model_fields if name not in _UNREAD]
    return [name for name in fields if getattr(one, name) != getattr(other, name)]


def _check_same_press(press: TaughtPress, wanted: FingerDesign, preset: Preset, number: int) -> None:
    """Check that a press, which may have been stored, is the one that is wanted."""
    same = press.preset == preset and press.design.indenter == wanted.indenter
    if not same or _differs(press.design, wanted):
        what = f"press {number + 1} in the folder of presses belongs to another design, mesh or version"
        raise SimulateError(f"{what}; give another --out, or remove NAME.presses beside --out")


def press_to_teach(
    design: FingerDesign, preset: Preset, settings: TrainingSettings, number: int, progress: Progress | None
) -> TaughtPress:
    """Press by finite elements."""
    begun, sound = time.process_time(), 0

    def count(pressed: PressedFinger) -> None:
        nonlocal sound
        sound += not (pressed.crossing or pressed.unstable)

    def tell(done: int, total: int, what: str) -> None:
        if progress is not None:
            progress(number * total + done, settings.presses * total, f"press {number + 1}: {what}")

    how = PressSettings(preset, _INCREMENTS, settings.threads, "penalty")
    pressed = press_finger(design, how, store=count, progress=tell)
    return TaughtPress(
        preset=preset,
        design=design,
        depth_mm=pressed.depth_mm,
        force_n=pressed.force_n,
        displacement_mm=pressed.displacement_mm.astype(np.float32),
        sound=sound,
        unreached=pressed.unreached,
        processor_s=time.process_time() - begun,
    )


def _bars(learned: _Learned, samples: Samples, asked: Floats) -> dict[str, Any]:
    """Return the bars, and the errors of presses left out, as fields of the record."""
    surface, surface_bar, surface_floor = _bar(learned.surface, learned.surface_products, samples, asked)
    force, force_bar, force_floor = _bar(learned.force, learned.force_products, samples, asked)
    return {
        "surface_bar_rel": surface_bar,
        "surface_floor_rel": surface_floor,
        "force_bar_rel": force_bar,
        "force_floor_rel": force_floor,
        "left_out_surface_rel": surface / samples.own_rel,
        "left_out_force_rel": force / samples.force_rel,
    }


def _surrogate(
    design: FingerDesign,
    preset: Preset,
    family: PressFamily,
    condensed: Condensation,
    samples: Samples,
    learned: _Learned,
    processor_s: float,
) -> PressSurrogate:
    """Return what was learned as a record: modes of the samples, and bars by presses left out."""
    rests = samples.rest_rel
    values, vectors = np.linalg.eigh(np.asarray(rests @ rests.T, dtype=np.float64))
    kept = np.argsort(values)[::-1][: min(_MOST_MODES, len(samples))]
    modes = ((vectors[:, kept] / np.sqrt(np.maximum(values[kept], np.finfo(float).tiny))).T @ rests).astype(np.float32)
    presses, asked = int(samples.press.max()) + 1, family.evenly(qmc.Sobol(_FEATURES, seed=2).random(_ASKED))
    return PressSurrogate(
        name=f"{design.name}, trained on {presses} presses",
        label=f"surrogate trained on {presses} presses by finite elements",
        preset=preset,
        design=design,
        family=family,
        presses=presses,
        compliance_mm_per_n=condensed.compliance_mm_per_n,
        shapes=condensed.shapes,
        shape_compliance_mm_per_n=condensed.shape_compliance_mm_per_n,
        shapes_rest_rel=condensed.far_rest_rel,
        sample_press=samples.press,
        sample_features=samples.features,
        modes=modes,
        amplitudes_rel=rests @ modes.T,
        modes_rest_rel=float(np.sqrt(max(0.0, 1.0 - values[kept].sum() / values.sum()))),
        force_rest_rel=samples.force_rest_rel,
        surface_kernel=learned.surface.kernel,
        force_kernel=learned.force.kernel,
        level_share=LEVEL,
        **_bars(learned, samples, asked),
        crossed_features=samples.crossed if len(samples.crossed) else None,
        processor_s=processor_s,
    )


@dataclass(frozen=True, slots=True)
class SurrogatePress:
    """What a surrogate answers of a press.

    Attributes
    ----------
    indenter
        With its push.
    contact
        On the condensed finger: which points touch, and their share of the pressure.
    displacement_mm, force_n
        Of the mesh's nodes (n, 3); on the indenter (3,).
    force_bar_n, surface_bar_mm
        They hold the force's error along the normal, and the root mean square one of the coat, in 95 % of presses.
    doubt
        Why finite elements should press instead; empty where the answer is good.
    """

    indenter: Indenter
    contact: CondensedContact
    displacement_mm: Floats
    force_n: Floats
    force_bar_n: float
    surface_bar_mm: float
    doubt: str


class SurrogateFinger:
    """A taught surrogate, opened once to answer many presses.

    Parameters
    ----------
    record
        What :func:`train_surrogate` returned.
    limit_rel
        A bar over the force, or over the coat's own displacement, from which an answer is doubted.
    """

    def __init__(self, record: PressSurrogate, limit_rel: float = LIMIT_REL) -> None:
        self.record, self.limit_rel = record, limit_rel
        rows = record.shapes, record.shape_compliance_mm_per_n, record.shapes_rest_rel
        self.finger = CondensedFinger(record.design, record.preset, Condensation(record.compliance_mm_per_n, *rows))
        self._surface = Process(record.surface_kernel, record.sample_features)
        self._force = Process(record.force_kernel, record.sample_features)
        self._surface_inverse: Floats = np.asarray(np.linalg.inv(self._surface.matrix), np.float64)
        self._force_inverse: Floats = np.asarray(np.linalg.inv(self._force.matrix), np.float64)

    def press(self, indenter: Indenter) -> SurrogatePress:
        """Return the answer to a press, in some 20 ms of processor time on the coarse 70 x 35 finger.

        u = u_condensed + d sum_i w_i(x) a_i modes and F = F_condensed (1 + sum_i v_i(x) r_i), with the processes'
        weights w, v of the samples at the press's features x, the samples' amplitudes a and rests r, and the push d.

        Parameters
        ----------
        indenter
            Cylinder or ball of the family, with its place and push.

        Raises
        ------
        SimulateError
            When the press is none of the family, or its contact is not found.
        """
        record = self.record
        if why := record.family.outside(indenter):
            raise SimulateError(f"the surrogate does not cover {why}; change this value, or press by finite elements")
        design = record.design.model_copy(update={"indenter": indenter})
        contact = self.finger.press(rigid_indenter(design), indenter.depth_mm)
        place = record.family.features(indenter)[None]
        weights, surface = self._at(self._surface, self._surface_inverse, place)
        pulls, force = self._at(self._force, self._force_inverse, place)
        rest = ((weights @ record.amplitudes_rel).astype(np.float32) @ record.modes).reshape(-1, 3)
        displacement = self.finger.displacement_mm(contact) + indenter.depth_mm * rest
        pushed = contact.force_n + contact.force_n[1] * (pulls @ record.force_rest_rel)
        push, own = float(pushed[1]), rms_length(displacement[self.finger.coat])
        force_bar = record.force_bar_rel * (force + record.force_floor_rel) * float(contact.force_n[1])
        surface_bar = record.surface_bar_rel * (surface + record.surface_floor_rel) * indenter.depth_mm
        force_bar, surface_bar = force_bar + _SETTLED_REL * push, surface_bar + _SETTLED_REL * own
        doubt = self._doubt(place[0], (force_bar / push, surface_bar / own))
        return SurrogatePress(indenter, contact, displacement, pushed, force_bar, surface_bar, doubt)

    def _at(self, process: Process, inverse: Floats, place: Floats) -> tuple[Floats, float]:
        """Return the weights (s,) of the samples at one place (1, d), and the standard deviation."""
        between = process.between(place)[0]
        weights = inverse @ between
        spread = max(0.0, float(process.at_themselves(place)[0] - weights @ between)) + process.kernel.noise_rel
        return weights, float(np.sqrt(process.kernel.variance_rel * spread))

    def _doubt(self, place: Floats, shares: tuple[float, float]) -> str:
        """Return why an answer is not to be taken."""
        for what, share in zip(("force", "surface"), shares, strict=True):
            if not share <= self.limit_rel:
                return f"its {what} may be wrong by {100 * share:.1f} % (at most {100 * self.limit_rel:.1f} % allowed)"
        if self.record.crossed_features is not None:
            sets = (self.record.crossed_features, self.record.sample_features)
            squares = [((places - place) / self.record.surface_kernel.lengths) ** 2 for places in sets]
            if squares[0].sum(axis=1).min() <= squares[1].sum(axis=1).min():
                return "in the most similar of its training presses, ribs pass through each other or buckle"
        return ""

    def surfaces(self, press: SurrogatePress) -> FingerSurfaces:
        """Return the pressed finger as the optics renders it."""
        vertices, rest = self._vertices
        pressed = self._pressed([press])
        return rest.model_copy(
            update={
                "label": f"{self.record.label}, push of {press.indenter.depth_mm:g} mm",
                "push_mm": press.indenter.depth_mm,
                "vertices_mm": rest.rest_vertices_mm + press.displacement_mm[vertices],
                "contact_distance": contact_distance(pressed, self.finger.coat),
            }
        )

    @cached_property
    def _vertices(self) -> tuple[Integers, FingerSurfaces]:
        """Node of each vertex of the surfaces, and the surfaces at rest."""
        design, mesh = self.record.design, self.finger.mesh
        rest = shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra)
        stored = store_shapes(rest, rest, f"{design.name}, pressed")
        numbers = np.zeros_like(mesh.nodes_mm)
        numbers[:, 0] = np.arange(len(numbers))
        shifted = store_shapes(rest, shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra, numbers), "numbered")
        return np.rint(shifted.vertices_mm[:, 0] - stored.vertices_mm[:, 0]).astype(np.int64), stored

    def _pressed(self, presses: Sequence[SurrogatePress]) -> PressedFinger:
        """Return answers to rising pushes as a press."""
        last = presses[-1]
        unknown = np.full(len(presses), np.nan)
        return PressedFinger(
            mesh=self.finger.mesh,
            depth_mm=np.array([press.indenter.depth_mm for press in presses]),
            force_n=np.array([press.force_n for press in presses]),
            energy_n_mm=unknown,
            displacement_mm=np.array([press.displacement_mm for press in presses]),
            iterations=np.array([press.contact.rounds for press in presses], dtype=np.int64),
            modes_mm=(),
            pressure_mpa=last.contact.pressure_mpa * float(last.force_n[1] / last.contact.force_n[1]),
            touch_mm=last.contact.touch_mm,
            unreached="",
            contact="frictionless contact, computed with the finger condensed to its coat; strains and bending "
            "learned from presses with penalty contact",
            kind="penalty",
        )

    def press_as_designed(
        self, design: FingerDesign, increments: int
    ) -> tuple[PressedFinger, SurrogateBars, tuple[str, ...], str]:
        """Return the press of a design with its bars, for :func:`~sim.experiments.press_records`; notes; any doubt.

        With the pushes on its way, as far as they are in the family.

        Raises
        ------
        SimulateError
            When the design is another finger, or its press none of the family.
        """
        self.check_design(design)
        if why := self.record.family.outside(design.indenter):
            raise SimulateError(f"the surrogate does not cover {why}; change this value, or press by finite elements")
        depth, least = design.indenter.depth_mm, self.record.family.depth_mm[0]
        pushes = [push for k in range(increments) if (push := depth * (k + 1) / increments) >= least]
        answers = [self.press(design.indenter.model_copy(update={"depth_mm": push})) for push in pushes]
        pressed, last = self._pressed(answers), answers[-1]
        bars = SurrogateBars(
            level_share=self.record.level_share,
            presses=self.record.presses,
            limit_rel=self.limit_rel,
            force_bar_n=np.array([answer.force_bar_n for answer in answers]),
            surface_bar_mm=np.array([answer.surface_bar_mm for answer in answers]),
        )
        notes = (
            f"a surrogate: in {100 * bars.level_share:.0f} % of presses the force is within {last.force_bar_n:.2g} N, "
            f"the coat within {1e3 * last.surface_bar_mm:.2g} um (root mean square) of finite elements",
            "the surrogate gives no energies; pressures are the condensed finger's, scaled to add up to the force",
        )
        return pressed, bars, notes, last.doubt

    def check_design(self, design: FingerDesign) -> None:
        """Check that a design is the finger that was taught, else raise SimulateError; its indenter may be another."""
        other = _differs(self.record.design, design)
        if other:
            raise SimulateError(
                f"the surrogate was trained for another design, which differs in {', '.join(other)}; train one with "
                "'finray simulate teach', or press without --surrogate"
            )
