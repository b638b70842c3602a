"""Shards of a data set, read by the rules of WebDataset: files whose names begin alike are one sample."""

import json
import tarfile
from itertools import groupby
from pathlib import Path
from typing import Any


def read_shard(path: Path) -> list[dict[str, Any]]:
    """Return the samples of a shard: ``__key__``, and by ending the bytes of each file, of JSON the object."""
    with tarfile.open(path) as archive:
        files = [(*member.name.split(".", 1), archive.extractfile(member).read()) for member in archive]
    return [
        {"__key__": key}
        | {ending: json.loads(content) if ending == "json" else content for _, ending, content in of_one}
        for key, of_one in groupby(files, key=lambda file: file[0])
    ]
