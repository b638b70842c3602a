"""What stands beside the shards of a data set for learning: its index as CSV and Parquet, its card; and its reader.

Shards follow the rules of WebDataset: files of one sample share the name up to the first dot and stand together.
"""

import csv
import importlib
import importlib.util
import io
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final

from data_schemas import DatasetSample, DatasetShard, LearningDataset, Provenance, RecordError
from data_schemas.storage import open_regular, parse_json

_LARGEST_MEMBER_BYTES: Final = 256 << 20
_FIELDS: Final = (
    "sample",
    "key",
    "shard",
    "press",
    "split",
    "light",
    "paint",
    "shape",
    "radius_mm",
    "depth_mm",
    "position_mm",
    "across_mm",
    "light_angles_deg",
    "red_draw",
    "green_draw",
    "red_emission_factor",
    "green_emission_factor",
    "render_seed",
    "red_gain",
    "green_gain",
    "blue_gain",
    "clipped_share",
    "render_noise_rel",
    "largest_depth_mm",
    "force_n",
    "slip_torque_per_friction_n_mm",
)


def index_rows(shards: Iterable[DatasetShard]) -> list[dict[str, Any]]:
    """Return one row a sample, in the order of the shards, with plain values; None where a label has none."""
    return [_row(sample, f"shard-{shard.number:06d}.tar") for shard in shards for sample in shard.samples]


def _row(sample: DatasetSample, shard: str) -> dict[str, Any]:
    """Return the labels of a sample as one row."""
    indenter = sample.indenter
    plain = {
        name: getattr(sample, name)
        for name in ("sample", "press", "split", "light", "paint", "render_seed", "clipped_share", "render_noise_rel",
                     "largest_depth_mm", "force_n", "slip_torque_per_friction_n_mm")
    }  # fmt: skip
    row = {
        **plain,
        "key": f"{sample.sample:06d}",
        "shard": shard,
        **{name: getattr(indenter, name) for name in ("shape", "radius_mm", "depth_mm", "position_mm", "across_mm")},
        "light_angles_deg": " ".join(f"{angle:.6g}" for angle in sample.light_angles_deg),
        **{f"{colour}_draw": sample.emission_draws.get(colour) for colour in ("red", "green")},
        **{f"{colour}_emission_factor": sample.emission_factors.get(colour) for colour in ("red", "green")},
        **dict(zip(("red_gain", "green_gain", "blue_gain"), sample.gains, strict=True)),
    }
    return {name: row[name] for name in _FIELDS}


def index_csv(shards: Iterable[DatasetShard]) -> bytes:
    """Return the index as CSV with one row a sample; an empty cell where a label has no value."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(index_rows(shards))
    return text.getvalue().encode()


def index_parquet(shards: Iterable[DatasetShard]) -> bytes | None:
    """Return the index as Parquet; None where pyarrow is not installed."""
    return parquet_table(index_rows(shards))


def parquet_table(rows: Iterable[Mapping[str, Any]]) -> bytes | None:
    """Return a table as Parquet, a column for each key; None where pyarrow is not installed.

    A column in which numbers and words stand together is text.
    """
    if importlib.util.find_spec("pyarrow") is None:
        return None
    arrow, parquet = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    stream = io.BytesIO()
    table = [dict(row) for row in rows]
    columns = {name: _of_one_kind([row.get(name) for row in table]) for name in dict.fromkeys(chain(*table))}
    parquet.write_table(arrow.table(columns), stream)
    return stream.getvalue()


def _of_one_kind(values: Sequence[Any]) -> list[Any]:
    """Return the values of a column, as text where some are words or truths and others are not."""
    kinds = {type(value) if isinstance(value, str | bool) else object for value in values if value is not None}
    if len(kinds) <= 1:
        return list(values)
    return [value if value is None or isinstance(value, str) else str(value) for value in values]


def read_shard(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the samples of a shard by the rules of WebDataset.

    Parameters
    ----------
    path
        TAR file.

    Yields
    ------
    dict
        ``__key__``, and by ending (``rgb.png``, ``json`` and so on) the bytes of each file; of JSON the object.

    Raises
    ------
    RecordError
        It is no TAR file, or is cut off.
    """
    with open_regular(path) as file:
        try:
            with tarfile.open(fileobj=file, mode="r:") as archive:
                yield from _grouped(archive, path)
        except tarfile.TarError as error:
            raise RecordError(
                f"{path}: is not a shard of a data set, or it is cut off ({error}); compute it again"
            ) from None


def _grouped(archive: tarfile.TarFile, path: Path) -> Iterator[dict[str, Any]]:
    """Yield files that share a key as one sample."""
    sample: dict[str, Any] = {}
    for member in archive:
        key, _, ending = member.name.partition(".")
        stream = archive.extractfile(member) if member.isreg() and ending else None
        if stream is None or member.size > _LARGEST_MEMBER_BYTES:
            raise RecordError(f"{path}: {member.name} must be a plain file named KEY.ENDING, of at most 256 MB")
        if sample and sample["__key__"] != key:
            yield sample
            sample = {}
        content = stream.read()
        sample["__key__"] = key
        sample[ending] = parse_json(content, path) if ending == "json" else content
    if sample:
        yield sample


_CARD: Final = """\
# {name}: presses for learning

{samples} samples of {presses} random presses of the finger `{design}`, simulated by finray {version}; none was
measured. Made by `{command}`.

## What a sample is

Samples are stored in `shards/shard-*.tar` by the rules of WebDataset: files of one key belong together.

- `KEY.rgb.png`: picture with contact, sRGB, 8 bit, {columns} x {rows} pixels, one for each Bayer cell of the camera.
- `KEY.rest.png`: the same without contact.
- `KEY.depth.png`: how far the point of the coat that a pixel sees has moved inward, against its normal at rest: grey,
  16 bit, depth_um = value - 32768; 0 where no coat is seen. Negative depths are the bulge around a contact{bending}.
- `KEY.normals.png`: outward unit normal of the coat there, 16 bit, (x, y, z) = (value - 1) / 32767 - 1 in the order
  red, green, blue; (0, 0, 0) where no coat is seen. Axes: x across the pad, y out of it, z along it from the base; of a
  flat pad of height h the normal is along (-dh/dx, 1, -dh/dz).
- `KEY.json`: labels, that is press, part, indenter, angles of the light, draws of the paints, gains, noise, force.

`places_mm.npy` (rows, columns, 2) says which place of the pad at rest each pixel sees, x and z in mm; NaN off the coat.
`index.csv`{parquet} holds the labels of all samples, one row each. Lengths are in mm, angles in degrees, force in N.

Pictures are linear camera RGB times `gains`, then sRGB. The gains set the coat without contact to {level:g} of white in
each channel, as a camera with a fixed exposure and white balance would: divide by them to get back radiance relative to
the light panel's. `clipped_share` of the coat's pixels are at 255 in a channel.

## How it was made

| drawn for | what | range |
|---|---|---|
| each press | shape of the indenter | {shapes} |
| each press | radius | {radius} mm, evenly |
| each press | push from first touch | {depth} mm, evenly |
| each press | place | evenly where all of the contact lies on the pad, seen by the camera or not |
| {lights} times each press | angle of each light panel | the design's +- {reach:g} deg, evenly |
| {paints} times each light | emission of each paint | a posterior draw, or its own times {lowest:.3g} to {ratio:g} |

The press is {press}.

Rendered with baked walls (level b), {spp} paths per pixel and twice as many near the contact, and the same random
numbers without and with contact.
{sources}
**One press appears in {reuse} samples.** Keep its samples together, as the column `split` of the index (and of
`KEY.json`) does: of ten presses, eight are to train, one is to validate and one is to test (here {split}).
Samples of one press count once when an error is averaged: its interval comes from presses, not from samples.

## What it does not hold

{lacks}

## How to read it

```python
import cv2
import numpy as np
import webdataset


def pictures(sample):
    stored = {{name: cv2.imdecode(np.frombuffer(sample[name], np.uint8), cv2.IMREAD_UNCHANGED)
              for name in ("rgb.png", "rest.png", "depth.png", "normals.png")}}
    rgb, rest = (stored[name][..., ::-1] for name in ("rgb.png", "rest.png"))  # cv2 gives blue first
    depth_um = np.where(stored["depth.png"] > 0, stored["depth.png"] - 32768.0, np.nan)
    normals = (stored["normals.png"][..., ::-1] - 1.0) / 32767.0 - 1.0
    return rgb, rest, depth_um, normals, sample["json"]


train = (
    webdataset.WebDataset("shards/shard-{braces}.tar", shardshuffle=False)
    .decode()
    .select(lambda sample: sample["json"]["split"] == "train")
    .map(pictures)
)
```

Or with the standard library: `tarfile` yields the files in order; the key ends at the first dot. Check the files with
`sha256sum --check manifest-sha256.txt`. The same command continues an interrupted data set, and with a larger
`--presses` adds whole shards.

## Licence

{licence}
"""


_ANALYTIC: Final = "analytic: the pad takes the indenter's shape at once and keeps its volume; no mechanics is solved"
_NO_LICENCE: Final = """\
Not stated. The samples hold only what the command above computed from the design and the paints, so whoever ran it may
state a licence here."""


def dataset_card(dataset: LearningDataset, origin: Provenance, has_parquet: bool) -> bytes:
    """Return the card of a data set (README.md): what it holds and does not, how it was made, how to read it.

    Parameters
    ----------
    dataset
        The record.
    origin
        Its provenance: the command and the version.
    has_parquet
        Whether the index is there as Parquet too.
    """
    design = dataset.plan.design
    words = {
        **_sampling_words(dataset),
        "name": dataset.name,
        "samples": dataset.samples,
        "presses": dataset.presses - len(dataset.failures),
        "design": design.name,
        "version": origin.package_version,
        "command": origin.command,
        "columns": design.camera.width_px // 2,
        "rows": design.camera.height_px // 2,
        "parquet": " (and `index.parquet`)" if has_parquet else "",
        "split": ", ".join(f"{count} {part}" for part, count in dataset.split_presses.items()),
        "lacks": "\n".join(f"- {note}" for note in (*dataset.notes, *_failed(dataset))),
        "braces": f"{{000000..{len(dataset.shards) - 1:06d}}}",
        "licence": _NO_LICENCE,
    }
    return _CARD.format(**words).encode()


def _failed(dataset: LearningDataset) -> Iterator[str]:
    """Yield a line for each press that failed."""
    for failure in dataset.failures:
        yield f"press {failure.press}, which could not be computed: {failure.reason}"


def _sampling_words(dataset: LearningDataset) -> dict[str, Any]:
    """Return what the card says of ranges, press and render."""
    plan = dataset.plan
    by_elements = plan.press == "finite elements"
    steps = f"finite elements, {plan.design.mesh.preset} mesh, {plan.increments} steps"
    sources = "".join(f"Paint of the {colour} wall: {source}.\n" for colour, source in dataset.paints.items())
    return {
        "bending": ", and part of a depth is the bending of the whole finger" if by_elements else "",
        "level": dataset.rest_level_rel,
        "shapes": " or ".join(plan.shapes),
        "radius": "{:g} to {:g}".format(*plan.radius_mm),
        "depth": "{:g} to {:g}".format(*plan.depth_mm),
        "lights": plan.lights,
        "reach": plan.light_angle_reach_deg,
        "paints": plan.paints,
        "lowest": 1.0 / plan.emission_ratio,
        "ratio": plan.emission_ratio,
        "press": steps if by_elements else _ANALYTIC,
        "spp": plan.samples_per_pixel,
        "sources": f"\n{sources}" if sources else "",
        "reuse": plan.lights * plan.paints,
    }
