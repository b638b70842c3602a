"""A paint, measured by a photodiode behind filters: integrals of its own, which share no code with the project."""

from dataclasses import dataclass

import numpy as np

NM = np.arange(380.0, 780.0, 0.1)
CENTERS_NM = (450.0, 500.0, 532.0, 560.0, 600.0, 630.0, 660.0)
WHITE = 0.98
READINGS = ("paint_laser", "white_laser", "paint_lamp", "white_lamp")


def bell(center_nm, fwhm_nm, order=1):
    return 2.0 ** (-(np.abs(2 * (NM - center_nm) / fwhm_nm) ** (2 * order)))


def area(values):
    return values.sum(axis=-1) * (NM[1] - NM[0])


@dataclass
class Truth:
    """What is painted: its emission has the tails of dyes, and is wider to the red by `skew`, in wavenumber."""

    mode_nm: float = 597.0
    width_per_mm: float = 134.0  # 48 nm
    skew: float = 0.2
    energy_yield: float = 0.3
    reflected: float = 0.08

    @property
    def emission_per_nm(self):
        off = 1e6 / self.mode_nm - 1e6 / NM
        x = 2 * off / (self.width_per_mm * (1 + self.skew * np.sign(off)))
        curve = np.where(NM < 450.0, 0.0, 0.7 * np.exp2(-(x**2)) + 0.3 / (1 + x**2))
        return self.energy_yield * curve / area(curve)

    @property
    def fwhm_nm(self):
        curve = self.emission_per_nm
        above = NM[curve >= curve.max() / 2]
        return above[-1] - above[0]


def readings(truth=Truth(), response=0.3 + 0.001 * (NM - 450.0), lamp_k=2856.0):  # noqa: B008
    """Return reading -> value by filter, in units of the photodiode's current, without noise."""
    lamp = NM**-5.0 / np.expm1(1.438776877e7 / (NM * lamp_k))
    lamp, laser = lamp / lamp.max(), 20.0 * bell(450.0, 2.0) / area(bell(450.0, 2.0))
    passed = np.array([0.6 * bell(nm, 10.0, order=2) + 1e-5 for nm in CENTERS_NM]) * response
    sent_back = truth.reflected * laser + 20.0 * truth.emission_per_nm
    reflected = np.where(truth.mode_nm - 30 > NM, 0.1, 0.7) * lamp
    lit = reflected + truth.emission_per_nm * area(np.where(truth.mode_nm - 40 > NM, lamp, 0.0)) * 0.8
    sources = (sent_back, WHITE * laser, lit, WHITE * lamp)
    found = {name: area(passed * source) for name, source in zip(READINGS, sources, strict=True)}
    found["white_laser"] = np.where(np.array(CENTERS_NM) == 450.0, found["white_laser"], np.nan)
    return found


def measured(values, sd_rel=0.005, dark=0.0, seed=1):
    """Return reading -> value and its standard uncertainty, with noise, on a dark reading."""
    rng = np.random.default_rng(seed)
    rows = {}
    for name, value in values.items():
        sd = sd_rel * np.abs(value) + 1e-6
        rows[name] = value + sd * rng.standard_normal(value.shape) + dark
        rows[f"{name}_sd"] = sd
    return rows


def table(columns, names=None, mark=",", point="."):
    """Return the text of a table; NaN is an empty cell."""
    names = [f"{nm:g}" for nm in CENTERS_NM] if names is None else names
    lines = [mark.join(["filter", *columns])]
    for k, name in enumerate(names):
        cells = [v[k] for v in columns.values()]
        texts = [c if isinstance(c, str) else "" if np.isnan(c) else repr(float(c)).replace(".", point) for c in cells]
        lines.append(mark.join([name, *texts]))
    return "\n".join(lines) + "\n"
