r"""Why a simulation is off: how much skill is lost by pose, size, depth, gain, shading, blur and halo.

Each cause is a small change of the simulated contact image. With the simulation's own change by contact :math:`c`,

.. math:: S' = e^{g + p \cdot x} \left[ B + G_\sigma * \left\{ (1 + a) (1 + h [d > 1])\, c(T x) \right\} \right]

where T shifts and stretches about the contact (pose, size), a is depth, h halo, G blur, g gain and p shading, both per
channel. Causes are chosen one by one, by what they explain of the residual, and then fitted together by
Gauss-Newton steps, over pixels up to 3.5 half-widths from the contact that are not nearly clipped.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final, Literal, TypeVar, get_args

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from data_schemas import CauseParameter, ErrorAttribution, ErrorCause
from finray_calib.compare._comparison import Comparison
from finray_calib.compare._image_noise import NO_NOISE, block_mean, mean_level
from finray_calib.compare._region_sums import error_variance
from finray_calib.compare._regions import every_channel, tile_indices

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Image = TypeVar("Image", NDArray[np.float64], NDArray[np.float32])
Cause = Literal["pose", "size", "depth", "gain", "shading", "blur", "halo"]
CAUSES: Final = get_args(Cause)

#: Parameters of each cause: name, unit, and factor from the fit's own unit.
_PARAMETERS: Final[Mapping[Cause, tuple[tuple[str, str], ...]]] = {
    "pose": (("along columns", "px"), ("along rows", "px")),
    "size": (("radius", "1"),),
    "depth": (("strength", "1"),),
    "gain": (("red", "1"), ("green", "1"), ("blue", "1")),
    "shading": tuple((f"{c} along {way}", "1") for way in ("columns", "rows") for c in ("red", "green", "blue")),
    "blur": (("sigma", "px"),),
    "halo": (("strength", "1"),),
}
#: The rows of each cause among those of all.
_OWN: Final[Mapping[Cause, NDArray[np.intp]]] = dict(
    zip(
        CAUSES,
        np.split(np.arange(sum(map(len, _PARAMETERS.values()))), np.cumsum([len(_PARAMETERS[c]) for c in CAUSES])[:-1]),
        strict=True,
    )
)
#: Before the images are looked at: px, shares, and px^2 of blur. Far wider than what images tell.
_PRIOR_SD: Final[Mapping[Cause, float]] = {
    "pose": 10.0, "size": 0.5, "depth": 1.0, "gain": 0.5, "shading": 0.5, "blur": 40.0, "halo": 1.0,
}  # fmt: skip
_STEPS: Final[Mapping[Cause, float]] = {"pose": 0.5, "size": 0.02, "blur": 1.5}
_LIGHT: Final = ("gain", "shading")
REACH: Final = 3.5
_NEARLY_CLIPPED: Final = 0.88
_LARGEST_SIDE_PX: Final = 176
_SMOOTH_PX: Final = 1.5
_PASSES: Final = 4
#: A cause must remove this share of what is left, and more than noise; its parameter must exceed three times its u.
_LEAST_SHARE, _TIMES_NOISE, _TIMES_U = 0.03, 4.0, 3.0
_TILE_PX: Final = 12
#: Effects that another cause imitates to this correlation are not told apart by one image.
_ALIKE: Final = 0.8
_RIDGE: Final = 1e-9
#: Largest step of one pass.
_LARGEST: Final[Mapping[Cause, float]] = {**dict.fromkeys(CAUSES, 0.7), "pose": 4.0, "blur": 12.0, "size": 0.15}


@dataclass(frozen=True, slots=True)
class _Scene:
    """Images (H, W, 3) around a contact, and what places in them mean.

    Attributes
    ----------
    rest, change, captured : ndarray, shape (H, W, 3)
        Simulated without contact, what contact adds to it, and the capture, in one unit.
    outside : ndarray, shape (H, W, 1)
        0 inside the contact, 1 outside.
    place : ndarray, shape (H, W, 2)
        Along columns and rows, -0.5 to 0.5 over the whole picture.
    centre_px : tuple of float
        Column and row of the contact.
    weights : ndarray, shape (3,)
    fitted, scored : ndarray of bool, shape (H, W)
        Pixels that the fit uses, and that the skill is formed over.
    side_px : float
        Raw pixels along the side of one pixel here.
    last : dict
        What was formed last, by kind: a pass of the fit asks for the same moved change and the same light many times.
    """

    rest: Floats
    change: Floats
    captured: Floats
    outside: Floats
    place: Floats
    centre_px: tuple[float, float]
    weights: Floats
    fitted: Bools
    scored: Bools
    side_px: float
    last: dict[str, tuple[bytes, Floats]] = field(init=False, default_factory=dict)

    def _once(self, kind: str, by: Floats, form: Callable[[], Floats]) -> Floats:
        """Return what is formed by some numbers, from memory where they are the last ones."""
        key = by.tobytes()
        if kind not in self.last or self.last[kind][0] != key:
            self.last[kind] = key, form()
        return self.last[kind][1]

    def changed(self, theta: Mapping[Cause, Floats]) -> Floats:
        """Return the simulation with these changes."""
        return self._lit(self.rest + self._change(theta), theta)

    def by_strength(self, cause: Literal["depth", "halo"], theta: Mapping[Cause, Floats]) -> Floats:
        """Return the derivative of the changed simulation by the strength of the change, or of its halo."""
        others = {c: value for c, value in theta.items() if c != cause}
        return self._lit(self._change(others, None if cause == "depth" else self.outside), theta)

    def _lit(self, image: Floats, theta: Mapping[Cause, Floats]) -> Floats:
        """Return an image with gain and shading."""
        if "gain" not in theta and "shading" not in theta:
            return image
        log_gain = theta.get("gain", np.zeros(3))
        if "shading" in theta:
            slope, by = theta["shading"].reshape(2, 3), np.concatenate([log_gain, theta["shading"]])
            return np.asarray(image * self._once("light", by, lambda: np.exp(log_gain + self.place @ slope)))
        return np.asarray(image * np.exp(log_gain))

    def _change(self, theta: Mapping[Cause, Floats], times: Floats | None = None) -> Floats:
        """Return what contact adds, before gain and shading; multiplied by something before it is blurred."""
        change = self.change
        if "pose" in theta or "size" in theta:
            zoom = float(np.exp(theta["size"][0])) if "size" in theta else 1.0
            shift = theta.get("pose", np.zeros(2)) + (1.0 - zoom) * np.array(self.centre_px)
            change = self._once("moved", np.append(shift, zoom), lambda: _moved(self.change, shift, zoom))
        if "depth" in theta:
            change = change * (1.0 + theta["depth"][0])
        if "halo" in theta:
            change = change * (1.0 + theta["halo"][0] * self.outside)
        if times is not None:
            change = change * times
        if "blur" in theta:
            change = _blurred(change, float(theta["blur"][0]))
        return change

    def residual(self, theta: Mapping[Cause, Floats]) -> Floats:
        """Return captured minus changed simulation."""
        return self.captured - self.changed(theta)

    def energy(self, image: Floats, other: Floats | None = None) -> float:
        """Return the weighted sum of squares, or of products, over the scored pixels."""
        second = image if other is None else other
        return float(((image * second) @ self.weights)[self.scored].sum())


@lru_cache(maxsize=4)
def _splines(size: int) -> CubicSpline:
    """Return the cubic splines through each unit vector; OpenCV's cubics move what they interpolate by up to half."""
    return CubicSpline(np.arange(size), np.eye(size), bc_type="natural")


def _moved(change: Floats, shift_px: Floats, zoom: float) -> Floats:
    """Return an image stretched about its first pixel, then shifted along columns and rows; beyond, its border."""
    axes = zip(change.shape[1::-1], shift_px, strict=True)
    along, down = (_splines(n)(np.clip((np.arange(n) - shift) / zoom, 0.0, n - 1.0)) for n, shift in axes)
    return np.ascontiguousarray(np.einsum("ij,jkc,lk->ilc", down, change, along, optimize=True))


def _blurred(change: Floats, variance_px2: float) -> Floats:
    """Return an image blurred by this variance; sharpened to first order where it is negative."""
    if abs(variance_px2) < 1e-6:
        return change
    soft = cv2.GaussianBlur(change, (0, 0), float(np.sqrt(abs(variance_px2))))
    return np.asarray(soft if variance_px2 > 0.0 else 2.0 * change - soft)


def attribute_error(
    comparison: Comparison, distance: Floats, block_px: int, full_scale_dn: float, skill: float
) -> ErrorAttribution | None:
    """Return the causes of a comparison's error over its headline region, the largest first.

    Parameters
    ----------
    comparison
        Both sides, with tone curve and gains taken out.
    distance : ndarray, shape (H, W)
        From the contact in half-widths.
    block_px
        Side of the blocks that the images are means of.
    full_scale_dn
        What is nearer to it than 12 % is left out of the fit: clipped light has no derivative.
    skill
        Of the headline region; 1 - skill is what the parts add up to.

    Returns
    -------
    ErrorAttribution or None
        None where too few pixels are left to fit.
    """
    scene, window = _scene(comparison, distance, block_px, full_scale_dn)
    if scene.fitted.sum() < 10 * _TILE_PX or not scene.change[scene.fitted].any():
        return None
    fit, known = _Fit.of(scene), _known_variance(comparison, scene, window)
    noise = fit.noise(_noise_variance(scene, known, {}))
    chosen = fit.choose(noise)
    theta, effects, u = fit.together(chosen, noise)
    kept = tuple(c for c in chosen if (np.abs(theta[c]) > _TIMES_U * u[c]).any())
    if kept != chosen:
        theta, effects, u = fit.together(kept, noise)
    variance = _noise_variance(scene, known, theta)
    return _attribution(comparison, window, fit, variance, (theta, effects, u), 1.0 - skill)


@dataclass(frozen=True, slots=True)
class _Window:
    """The part of the compared images that the scene shows, averaged over blocks."""

    rows: slice
    columns: slice
    side_px: int

    def cut(self, image: Image) -> Image:
        """Return that part of an image in its own pixels."""
        return image[self.rows, self.columns]

    def averaged(self, part: Floats) -> Floats:
        """Return the means of a part over blocks."""
        return part if self.side_px == 1 else block_mean(part, self.side_px)

    def of(self, image: Floats) -> Floats:
        """Return that part of an image, averaged."""
        return self.averaged(self.cut(image))

    def back(self, image: Floats, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return a map of the scene in the compared image, 0 elsewhere."""
        whole = np.zeros(shape, dtype=np.float32)
        large = np.repeat(np.repeat(image, self.side_px, axis=0), self.side_px, axis=1)
        top, left = self.rows.start, self.columns.start
        whole[top : top + large.shape[0], left : left + large.shape[1]] = large
        return whole


def _scene(comparison: Comparison, distance: Floats, block_px: int, full_scale_dn: float) -> tuple[_Scene, _Window]:
    """Return the images around the contact in few pixels."""
    layers, k = comparison.layers, comparison.best_exposure
    near = distance <= REACH
    rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    height, width = int(rows[-1] - rows[0] + 1), int(columns[-1] - columns[0] + 1)
    side = max(1, -(-max(height, width) // _LARGEST_SIDE_PX))
    height, width = height // side * side, width // side * side
    top, left = int(rows[0]), int(columns[0])
    window = _Window(slice(top, top + height), slice(left, left + width), side)
    simulated, rest = (
        window.averaged(k * layers.rgb(window.cut(image))) for image in (layers.contact, layers.no_contact)
    )
    captured, away = window.of(comparison.captured.contact), window.of(distance)
    used = np.where(comparison.used[-1], 1.0, np.nan)
    finite = every_channel(np.isfinite(captured) & np.isfinite(simulated))
    inside = away <= 1.0
    at = np.argwhere(inside).mean(axis=0) if inside.any() else np.array(away.shape) / 2.0
    dark = every_channel(simulated < _NEARLY_CLIPPED * full_scale_dn)
    y, x = np.mgrid[: away.shape[0], : away.shape[1]].astype(np.float64)
    rows_all, columns_all = distance.shape
    place = np.stack([(left + side * x) / columns_all - 0.5, (top + side * y) / rows_all - 0.5], axis=-1)
    return _Scene(
        rest=rest,
        change=np.nan_to_num(simulated - rest),
        captured=np.nan_to_num(captured),
        outside=np.clip((np.nan_to_num(away, nan=9.0) - 1.0) / 0.1, 0.0, 1.0)[..., None],
        place=place,
        centre_px=(float(at[1]), float(at[0])),
        weights=comparison.channel_weights,
        fitted=np.asarray(finite & dark & (away <= REACH), dtype=np.bool_),
        scored=np.asarray(finite & np.isfinite(window.of(used)), dtype=np.bool_),
        side_px=float(side * block_px),
    ), window


def _known_variance(comparison: Comparison, scene: _Scene, window: _Window) -> Floats:
    """Return the variance (3,) of a pixel's noise by what is known of both sides; 0 where nothing is."""
    captured, layers = comparison.captured, comparison.layers
    half = window.cut(layers.contact_half)
    if captured.noise is NO_NOISE and not half.any():
        return np.zeros(3)
    known = window.cut(error_variance(layers, captured, comparison.best_exposure))
    return np.asarray(np.nan_to_num(window.averaged(known))[scene.fitted].mean(axis=0) / window.side_px**2)


def _noise_variance(scene: _Scene, known: Floats, theta: Mapping[Cause, Floats]) -> Floats:
    """Return the variance (3,) of a pixel's noise: known, or from how neighbours differ in what causes leave."""
    if (known > 0.0).all():
        return known
    # mean of four neighbours, which a plane cancels: the variance of the difference is 5/4 of a pixel's
    kernel = np.array([[0.0, -0.25, 0.0], [-0.25, 1.0, -0.25], [0.0, -0.25, 0.0]])
    differences = cv2.filter2D(scene.residual(theta), -1, kernel)
    seen = cv2.erode(scene.fitted.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    if not seen.any():
        return np.zeros(3)
    found = np.zeros(3)
    for channel in range(3):
        squares = differences[..., channel][seen] ** 2
        # the median alone would jump between the steps of whole counts
        typical = squares[squares <= 16.0 * 1.4826**2 * np.median(squares)]
        found[channel] = 0.8 * typical.mean()
    return found


@dataclass(frozen=True, slots=True)
class _Rows:
    """Weighted derivatives at the P fitted pixels; those by gain and shading are 0 but in one channel.

    Attributes
    ----------
    wide : ndarray, shape (n, 3, P)
    narrow : ndarray, shape (m, P)
    channels : ndarray of int, shape (m,)
        Of the narrow ones.
    places : ndarray of int, shape (n + m,)
        Where each row stands among all: the wide ones first.
    """

    wide: Floats
    narrow: Floats
    channels: NDArray[np.intp]
    places: NDArray[np.intp]

    @classmethod
    def of(cls, parts: Sequence[Floats]) -> "_Rows":
        """Return the rows of causes in their order: (k, 3, P), or (k, P) in red, green, blue, red ... for light."""
        count, places = 0, ([], [])  # type: ignore[var-annotated]
        for part in parts:
            places[part.ndim == 2].extend(range(count, count := count + len(part)))
        pixels = parts[0].shape[-1]
        wide = np.concatenate([np.zeros((0, 3, pixels)), *(part for part in parts if part.ndim == 3)])
        narrow = np.concatenate([np.zeros((0, pixels)), *(part for part in parts if part.ndim == 2)])
        return cls(wide, narrow, np.arange(len(narrow)) % 3, np.array(places[0] + places[1], np.intp))

    @property
    def flat(self) -> Floats:
        """The wide ones, (n, 3 P)."""
        return self.wide.reshape(len(self.wide), self.wide.shape[1] * self.wide.shape[2])

    def with_each_other(self) -> Floats:
        """Return the products of the rows with each other."""
        n, flat = len(self.wide), self.flat
        products = np.zeros((len(self.places), len(self.places)))
        products[:n, :n] = flat @ flat.T
        for channel in range(3):
            own = np.flatnonzero(self.channels == channel)
            rows = self.narrow[own]
            products[np.ix_(n + own, n + own)] = rows @ rows.T
            products[n + own, :n] = rows @ self.wide[:, channel].T
            products[:n, n + own] = products[n + own, :n].T
        order = np.argsort(self.places)
        return np.asarray(products[np.ix_(order, order)])

    def with_image(self, image: Floats) -> Floats:
        """Return the products of the rows with a listed image (3, P)."""
        found = np.empty(len(self.places))
        found[self.places] = [*(self.flat @ image.ravel()), *(row @ image[channel] for row, channel in self._narrow())]
        return found

    def in_tiles(self, image: Floats, tile: NDArray[np.intp]) -> Floats:
        """Return the products (tiles, rows) of the rows with a listed image, over the pixels of each tile."""
        found: list[Floats] = [(row * image).sum(axis=0) for row in self.wide]
        found += [row * image[channel] for row, channel in self._narrow()]
        sums = np.stack([np.bincount(tile, weights=products) for products in found], axis=1)
        return np.asarray(sums[:, np.argsort(self.places)])

    def _narrow(self) -> list[tuple[Floats, int]]:
        """Return the narrow rows, each with its channel."""
        return list(zip(self.narrow, self.channels.tolist(), strict=True))

    def plus(self, steps: Floats) -> Floats:
        """Return the listed image (3, P) of all rows, each times its step."""
        n, by_row = len(self.wide), steps[self.places]
        image = np.tensordot(by_row[:n], self.wide, axes=1)
        for step, (row, channel) in zip(by_row[n:], self._narrow(), strict=True):
            image[channel] += step * row
        return np.asarray(image)


@dataclass(frozen=True, slots=True)
class _Fit:
    """Choose and fit causes on one scene.

    Attributes
    ----------
    scene, smooth : _Scene
        The second with a smooth change: derivatives of noise are none of a cause.
    fitted : ndarray of int, shape (P,)
        Pixels that the fit uses.
    first, listed_first, all_rows, gram
        Where nothing is changed yet: derivatives (parameters, H, W, 3) by causes that change more than the light, rows
        of each cause and of all, and their products.
    """

    scene: _Scene
    smooth: _Scene
    fitted: NDArray[np.intp]
    first: Mapping[Cause, Floats]
    listed_first: Mapping[Cause, Floats]
    all_rows: _Rows
    gram: Floats

    @classmethod
    def of(cls, scene: _Scene) -> "_Fit":
        """Return the fit of a scene."""
        soft = cv2.GaussianBlur(scene.change, (0, 0), _SMOOTH_PX)
        smooth = replace(scene, change=np.asarray(soft, dtype=np.float64))
        fitted, image = np.flatnonzero(scene.fitted), scene.changed({})
        first = {c: _derivatives(smooth, c, {}) for c in CAUSES if c not in _LIGHT}
        listed = {c: _cause_rows(scene, fitted, c, image, first) for c in CAUSES}
        rows = _Rows.of([listed[c] for c in CAUSES])
        return cls(scene, smooth, fitted, first, listed, rows, rows.with_each_other())

    def noise(self, variance: Floats) -> float:
        """Return the mean variance of a weighted number, of the variances (3,) of a pixel."""
        return float(variance @ self.scene.weights) / 3.0

    def choose(self, variance: float) -> tuple[Cause, ...]:
        """Return the causes by forward selection, on one linearisation of all."""
        residual = _listed(self.scene, self.fitted, self.scene.residual({}))
        right = self.all_rows.with_image(residual)
        total = float((residual**2).sum())
        chosen: list[Cause] = []
        explained = 0.0
        while len(chosen) < len(CAUSES):
            tried = {}
            for c in CAUSES:
                if c not in chosen:
                    tried[c] = self._explained_by((*chosen, c), right)
            best = max(tried, key=lambda c: tried[c])
            more = tried[best] - explained
            if more < _LEAST_SHARE * (total - explained) or more < _TIMES_NOISE * len(_PARAMETERS[best]) * variance:
                break
            chosen.append(best)
            explained = tried[best]
        return tuple(chosen)

    def together(
        self, chosen: Sequence[Cause], variance: float
    ) -> tuple[dict[Cause, Floats], dict[Cause, Floats], dict[Cause, Floats]]:
        """Return parameters, effects (H, W, 3) and standard uncertainties of causes that are fitted together."""
        theta = {c: np.zeros(len(_PARAMETERS[c])) for c in chosen}
        effects = {c: np.zeros_like(self.scene.rest) for c in chosen}
        u: dict[Cause, Floats] = {c: np.zeros(len(_PARAMETERS[c])) for c in chosen}
        if not chosen:
            return theta, effects, u
        noise = max(variance, 1e-12)
        tile = tile_indices(self.scene.fitted, _TILE_PX)
        for number in range(_PASSES):
            image = self.scene.changed(theta)
            images, rows, hessian = self._linearised(chosen, theta, image, first=number == 0)
            residual = _listed(self.scene, self.fitted, self.scene.captured - image)
            # a move along a strip changes nothing: what the image does not tell stays where it is
            prior = noise / np.concatenate([np.full(len(theta[c]), _PRIOR_SD[c]) for c in chosen]) ** 2
            hessian += _RIDGE * np.diag(np.diag(hessian)) + np.diag(prior)
            moved = np.concatenate([theta[c] for c in chosen])
            step = np.linalg.solve(hessian, rows.with_image(residual) - prior * moved)
            is_last = number == _PASSES - 1 or _is_small(step, hessian, noise)
            spread = _spread(rows, residual - rows.plus(step), tile, hessian, noise) if is_last else moved
            at = 0
            for c in chosen:
                own = slice(at, at := at + len(theta[c]))
                moves = np.clip(step[own], -_LARGEST[c], _LARGEST[c])
                effects[c] = effects[c] + self._effect(c, moves, image, images)
                theta[c] = theta[c] + moves
                u[c] = spread[own]
            if is_last:
                break
        return theta, effects, u

    def _linearised(
        self, chosen: Sequence[Cause], theta: Mapping[Cause, Floats], image: Floats, first: bool
    ) -> tuple[Mapping[Cause, Floats], _Rows, Floats]:
        """Return derivatives by causes as images and as rows, and the rows' products; known for the first image."""
        if first:
            of = np.concatenate([_OWN[c] for c in chosen])
            return self.first, _Rows.of([self.listed_first[c] for c in chosen]), self.gram[np.ix_(of, of)].copy()
        # pose and size last: the others share one moved change
        order = sorted((c for c in chosen if c not in _LIGHT), key=lambda c: c in ("pose", "size"))
        images = {c: _derivatives(self.smooth, c, theta) for c in order}
        rows = _Rows.of([_cause_rows(self.scene, self.fitted, c, image, images) for c in chosen])
        return images, rows, rows.with_each_other()

    def _effect(self, cause: Cause, moves: Floats, image: Floats, images: Mapping[Cause, Floats]) -> Floats:
        """Return what moves of a cause's parameters change, to first order, in the image (H, W, 3)."""
        if cause == "gain":
            return image * moves
        if cause == "shading":
            return np.asarray(image * (self.scene.place @ moves.reshape(2, 3)))
        return np.asarray(sum(m * one for m, one in zip(moves, images[cause], strict=True)))

    def alike(self, cause: Cause, effect: Floats) -> tuple[str, ...]:
        """Return the causes that could imitate an effect."""
        wanted = _listed(self.scene, self.fitted, effect)
        size = float((wanted**2).sum())
        if not size > 0.0:
            return ()
        right = self.all_rows.with_image(wanted)
        like = {c: self._explained_by((c,), right) for c in CAUSES if c != cause}
        return tuple(c for c, explained in like.items() if np.sqrt(max(explained, 0.0) / size) >= _ALIKE)

    def _explained_by(self, causes: Sequence[Cause], right: Floats) -> float:
        """Return what causes explain of a residual's sum of squares, by the products of all rows with it."""
        of = np.concatenate([_OWN[c] for c in causes])
        return _explained(self.gram[np.ix_(of, of)], right[of])


def _listed(scene: _Scene, fitted: NDArray[np.intp], image: Floats) -> Floats:
    """Return some pixels of an image (H, W, 3), weighted, as lists (3, P)."""
    pixels = image.reshape(-1, 3).take(fitted, axis=0)
    return np.multiply(pixels.T, np.sqrt(scene.weights)[:, None], order="C")


def _cause_rows(
    scene: _Scene, fitted: NDArray[np.intp], cause: Cause, image: Floats, images: Mapping[Cause, Floats]
) -> Floats:
    """Return the listed derivatives of the changed simulation `image` by a cause: (k, P) by gain and shading."""
    if cause not in _LIGHT:
        return np.stack([_listed(scene, fitted, one) for one in images[cause]])
    pixels = _listed(scene, fitted, image)
    if cause == "gain":
        return pixels
    place = scene.place.reshape(-1, 2).take(fitted, axis=0)
    return np.concatenate([place[:, way] * pixels for way in range(2)])


def _derivatives(smooth: _Scene, cause: Cause, theta: Mapping[Cause, Floats]) -> Floats:
    """Return the derivatives (parameters, H, W, 3) of a smooth simulation by a cause's parameters."""
    if cause in ("depth", "halo"):  # the image is linear in them
        return smooth.by_strength(cause, theta)[None]
    start = theta.get(cause, np.zeros(len(_PARAMETERS[cause])))
    found = []
    for move in _STEPS[cause] * np.eye(len(start)):
        low = smooth.changed({**theta, cause: start - move})
        high = smooth.changed({**theta, cause: start + move})
        found.append((high - low) / (2.0 * move.sum()))
    return np.array(found)


def _spread(rows: _Rows, left: Floats, tile: NDArray[np.intp], hessian: Floats, noise: float) -> Floats:
    """Return standard uncertainties: residuals may be alike over tiles (sandwich), and noise is the least."""
    scores = rows.in_tiles(left, tile)
    inverse = np.linalg.inv(hessian)
    of_tiles = np.diag(inverse @ (scores.T @ scores) @ inverse)
    return np.asarray(np.sqrt(np.maximum(of_tiles, noise * np.diag(inverse))))


def _is_small(step: Floats, hessian: Floats, noise: float) -> bool:
    """Return whether a step is a tenth of what noise leaves unknown; the next one would be far smaller."""
    return bool((np.abs(step) <= 0.1 * np.sqrt(noise * np.diag(np.linalg.inv(hessian)))).all())


def _explained(gram: Floats, right: Floats) -> float:
    """Return what columns explain of a residual's sum of squares, by their products with each other and with it."""
    ridge = _RIDGE * np.diag(np.diag(gram)) + 1e-300 * np.eye(len(gram))
    return float(right @ np.linalg.solve(gram + ridge, right))


def _attribution(
    comparison: Comparison,
    window: _Window,
    fit: _Fit,
    variance: Floats,
    found: tuple[dict[Cause, Floats], dict[Cause, Floats], dict[Cause, Floats]],
    lost: float,
) -> ErrorAttribution:
    """Return the record: parts of 1 - skill that add up."""
    theta, effects, u = found
    scene = fit.scene
    left = scene.residual({})
    change = np.nan_to_num(window.of(comparison.captured.no_contact)) - scene.captured
    signal = max(scene.energy(change), 1e-300)
    noise = 0.0
    if not (comparison.sums[-1].noise.error > 0.0).any():  # else it is taken out of the score
        noise = float(variance @ scene.weights) * float(scene.scored.sum()) * window.side_px**2 / signal
    dark = scene.fitted[..., None]
    saturation = scene.energy(np.where(dark, 0.0, left)) / signal
    parts = {c: scene.energy(np.where(dark, left, 0.0), effects[c]) / signal for c in effects}
    order = sorted(parts, key=lambda c: -scene.energy(effects[c]))
    remainder = lost - saturation - noise - sum(parts.values())
    level = float(mean_level(comparison.captured.no_contact).mean())
    shape = (comparison.used[-1].shape[0], comparison.used[-1].shape[1])
    maps = [window.back(effects[c].mean(axis=-1) / level, shape) for c in order]
    return ErrorAttribution(
        causes=tuple(
            ErrorCause(
                cause=c,
                parameters=_in_pixels(c, theta[c], u[c], scene.side_px),
                skill_lost=parts[c],
                skill_regained=(scene.energy(left) - scene.energy(scene.residual({c: theta[c]}))) / signal,
                like=fit.alike(c, effects[c]),
                advice=_advice(c, theta[c], scene.side_px),
            )
            for c in order
        ),
        skill_lost=lost,
        saturation_skill=saturation,
        noise_skill=noise,
        remainder_skill=remainder,
        maps=np.stack(maps) if maps else None,
    )


def _in_pixels(cause: Cause, theta: Floats, u: Floats, px: float) -> tuple[CauseParameter, ...]:
    """Return the parameters in raw pixels, or as shares."""
    values, spread = theta, u
    if cause == "pose":
        values, spread = px * theta, px * u
    elif cause == "blur":
        sigma = float(np.sign(theta[0]) * np.sqrt(abs(theta[0])))
        values, spread = np.array([px * sigma]), np.array([px * u[0] / max(2.0 * abs(sigma), 1e-3)])
    elif cause in ("size", "gain", "shading"):
        values, spread = np.expm1(theta), np.exp(theta) * u
    return tuple(
        CauseParameter(name=name, unit=unit, value=float(v), u=float(s))
        for (name, unit), v, s in zip(_PARAMETERS[cause], values, spread, strict=True)
    )


def _advice(cause: Cause, theta: Floats, px: float) -> str:
    """Return what to do about a cause, with its size."""
    first = float(theta[0])
    share, stronger = f"{100 * abs(first):.0f} %", "stronger" if first > 0.0 else "weaker"
    if cause == "pose":
        dx, dy = px * theta
        return (
            f"the contact lies {abs(dx):.2g} px to the {'right' if dx > 0 else 'left'} and {abs(dy):.2g} px "
            f"{'below' if dy > 0 else 'above'} its simulated place: correct the circle (--circles), or refine the pose "
            "of the press"
        )
    if cause == "size":
        share = f"{100 * abs(np.expm1(first)):.0f} % {'larger' if first > 0.0 else 'smaller'}"
        return f"the contact is {share} than simulated: check the indenter's size, the depth and the scale"
    if cause == "depth":
        return (
            f"the change by contact is {share} {stronger} than simulated: check the depth of the press, and the "
            "contrast of the lights"
        )
    if cause == "gain":
        worst = float(theta[int(np.abs(theta).argmax())])
        how = f"{100 * abs(np.expm1(worst)):.1f} % {'brighter' if worst > 0 else 'darker'}"
        return (
            f"a channel of the contact image is {how} than simulated over the whole image: lock exposure and white "
            "balance, and take an image without contact just before the press"
        )
    if cause == "shading":
        return (
            f"the change of light across the picture differs by up to {100 * np.abs(np.expm1(theta)).max():.1f} % from "
            "the simulation: check how the light falls off with distance, and let the lights warm up"
        )
    if cause == "blur":
        sigma = px * np.sqrt(abs(first))
        if first > 0.0:
            what = "check the focus, or add the blur of lens and gel to the simulation"
            return f"the capture is {sigma:.2g} px more blurred than the simulation: {what}"
        return f"the simulation is {sigma:.2g} px more blurred than the capture: blur less, or render on a finer mesh"
    return (
        f"the change around the contact, where the gel bulges, is {share} {stronger} than simulated: use finite "
        "elements, not a rigid shape or a table of other presses; if you do, check the gel"
    )
