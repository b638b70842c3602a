"""Learn the prior of emission curves that the fit brings along, from measured fluorophores and matrices.

    python benchmarks/learn_measured_spectra.py --spectra ../shared/data/spectra

Each curve is aligned at its mode and scaled to its full width in wavenumber; alike shapes are averaged to prototypes of
at least five curves, and what is left is summarised by a few directions common to all. Only these numbers are stored:
the curves themselves stay where they are.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks.paints_of_dyes import complete, dyes
from finray_calib.fit._measured_spectra import LEAST_CURVES_OF_A_PROTOTYPE, PROTOTYPES_FILE, MeasuredSpectra
from finray_calib.spectra import WAVELENGTH_NM

Floats = np.ndarray
U: Floats = np.linspace(-4.0, 2.5, 131)
PROTOTYPES, DIRECTIONS = 12, 6
MODES_NM = (470.0, 720.0)
LASERS_NM = (420.0, 460.0)
LEAST_WIDTH_SD = 0.25
LARGEST_RESIDUAL_TIMES_MEDIAN = 3.0


def curves(spectra: Path) -> tuple[list[str], Floats]:
    """Return names and (n, L) emission curves of peak 1 of what runs out on both sides."""
    nm, all_dyes = dyes(spectra / "dyes.csv")
    names, rows = [], []
    for name, (_, emission) in all_dyes.items():
        if MODES_NM[0] <= nm[emission.argmax()] <= MODES_NM[1] and complete(nm, emission):
            names.append(name)
            rows.append(np.clip(PchipInterpolator(nm, emission)(WAVELENGTH_NM), 0, None))
    for path in sorted((spectra / "materials").glob("*.csv")):
        table = np.genfromtxt(path, delimiter=",", skip_header=4)
        header = next(line for line in path.read_text().splitlines() if not line.startswith("#"))
        excitation = np.array([float(cell) for cell in header.split(",")[1:]])
        lit = (excitation >= LASERS_NM[0]) & (excitation <= LASERS_NM[1])
        emitted = np.clip(table[:, 1:][:, lit].mean(axis=1) * (table[:, 0] >= 475), 0, None)
        names.append(path.stem)
        rows.append(np.clip(PchipInterpolator(table[:, 0], emitted)(WAVELENGTH_NM), 0, None))
    found = np.array(rows)
    return names, found / found.max(axis=1, keepdims=True)


def aligned(curve: Floats) -> tuple[Floats, float]:
    """Return a curve at U, and the logarithm of its full width in 1000 per cm."""
    nu = 1e4 / WAVELENGTH_NM[::-1]
    value = curve[::-1]
    top = int(value.argmax())
    blue = next((i for i in range(top, nu.size) if value[i] < 0.5), nu.size - 1)
    red = next((i for i in range(top, -1, -1) if value[i] < 0.5), 0)
    width = nu[blue] - nu[red]
    return np.interp(nu[top] + U * width, nu, value, left=0.0, right=0.0), float(np.log(width))


def alike(names: list[str], rows: Floats, left_out: str) -> Floats:
    """Return which curves are another one or resemble it."""
    unit = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    if left_out not in names:
        return np.zeros(len(names), dtype=bool)
    return np.asarray(unit @ unit[names.index(left_out)] > 0.995)


def learned(rows: Floats, prototypes: int = PROTOTYPES, directions: int = DIRECTIONS) -> MeasuredSpectra:
    """Return prototypes and directions of curves."""
    pairs = [aligned(row) for row in rows]
    shapes, ln_width = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
    member = clustered(shapes, prototypes)
    means = np.array([shapes[member == k].mean(axis=0) for k in range(member.max() + 1)])
    left = shapes - means[member]
    size = np.linalg.norm(left, axis=1)
    left *= np.minimum(1.0, LARGEST_RESIDUAL_TIMES_MEDIAN * np.median(size) / np.maximum(size, 1e-12))[:, None]
    _, scale, vectors = np.linalg.svd(left, full_matrices=False)
    count = np.bincount(member)
    # a prototype's widths: its own, drawn towards all by as much as five curves weigh
    overall, spread = ln_width.mean(), ln_width.std()
    centre = np.array([(ln_width[member == k].sum() + 5 * overall) / (count[k] + 5) for k in range(count.size)])
    square = [((ln_width[member == k] - centre[k]) ** 2).sum() for k in range(count.size)]
    sd = np.sqrt((np.array(square) + 5 * spread**2) / (count + 5))
    return MeasuredSpectra(
        u=U,
        shapes=means / means.max(axis=1, keepdims=True),
        directions=vectors[:directions] * (scale[:directions, None] / np.sqrt(len(rows) - count.size)),
        members=count.astype(float),
        ln_width_kk=centre,
        ln_width_sd=np.maximum(sd, LEAST_WIDTH_SD),
        origin=f"{len(rows)} measured emission curves: fluorophores in solution, ink, textile and papers",
    )


def clustered(shapes: Floats, number: int) -> Floats:
    """Return the cluster of each shape, by k-means; small clusters join the nearest."""
    rng = np.random.default_rng(7)
    best, least = np.zeros(len(shapes), dtype=int), np.inf
    for _ in range(12):
        centres = shapes[rng.choice(len(shapes), number, replace=False)]
        for _ in range(60):
            member = ((shapes[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
            centres = np.array(
                [shapes[member == k].mean(axis=0) if (member == k).any() else centres[k] for k in range(len(centres))]
            )
        while True:
            count = np.bincount(member, minlength=len(centres))
            small = [k for k in np.argsort(count) if count[k] < LEAST_CURVES_OF_A_PROTOTYPE]
            if not small or len(centres) == 1:
                break
            centres = np.delete(centres, small[0], axis=0)
            member = ((shapes[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
            centres = np.array([shapes[member == k].mean(axis=0) for k in range(len(centres)) if (member == k).any()])
            member = ((shapes[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
        cost = float(((shapes - centres[member]) ** 2).sum())
        if cost < least:
            best, least = np.unique(member, return_inverse=True)[1], cost
    return best


def as_json(spectra: MeasuredSpectra) -> str:
    """Return the file's text."""
    stored = {
        "origin": spectra.origin,
        "u": [float(spectra.u[0]), float(spectra.u[-1]), spectra.u.size],
        **{
            n: np.round(getattr(spectra, n), 4).tolist() for n in ("shapes", "directions", "ln_width_kk", "ln_width_sd")
        },
        "members": spectra.members.astype(int).tolist(),
    }
    return json.dumps(stored, separators=(",", ":")).replace('],"', '],\n"').replace("],[", "],\n[") + "\n"


def main() -> int:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spectra", type=Path, required=True, help="folder with dyes.csv and materials/")
    parser.add_argument("--out", type=Path, default=PROTOTYPES_FILE)
    arguments = parser.parse_args()
    spectra = learned(curves(arguments.spectra)[1])
    arguments.out.write_text(as_json(spectra), encoding="utf-8")
    print(f"{len(spectra.shapes)} prototypes of {spectra.members.astype(int).tolist()} curves")
    return 0


if __name__ == "__main__":
    sys.exit(main())
