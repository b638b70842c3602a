"""A reader of containers of tactile captures that needs numpy only, and nothing of finray.

    python examples/tactile-captures/read_captures.py fots.zip

The container is described in docs/reference/tactile-captures.md.
"""

import hashlib
import io
import json
import sys
import zipfile
from pathlib import Path

import numpy as np


def files_of(place):
    """Return name -> function that returns the bytes, of a folder or of a zip archive and its one folder."""
    if Path(place).is_dir():
        return {path.name: path.read_bytes for path in Path(place).iterdir() if path.is_file()}
    archive = zipfile.ZipFile(place)
    return {name.rpartition("/")[2]: lambda name=name: archive.read(name) for name in archive.namelist()}


def filled(value, arrays):
    """Put arrays where the JSON only names them."""
    if isinstance(value, dict):
        if value.keys() == {"array", "shape", "dtype"}:
            return arrays[value["array"]]
        return {key: filled(inner, arrays) for key, inner in value.items()}
    return [filled(inner, arrays) for inner in value] if isinstance(value, list) else value


def read_captures(place):
    """Yield name and content of every capture: images as counts (H, W, samples), the rest as JSON has it."""
    files = files_of(place)
    for name in sorted(name for name in files if name.endswith(".capture.json")):
        envelope = json.loads(files[name]())
        sealed = {key: value for key, value in envelope.items() if key != "content_sha256"}
        text = json.dumps(sealed, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        if hashlib.sha256(text.encode()).hexdigest() != envelope["content_sha256"]:
            raise ValueError(f"{name}: was changed after it was written")
        arrays, wanted = {}, envelope["array_file"]
        if wanted is not None:
            content = files[wanted["file"]]()
            if hashlib.sha256(content).hexdigest() != wanted["sha256"]:
                raise ValueError(f"{wanted['file']}: was changed after it was written")
            arrays = np.load(io.BytesIO(content), allow_pickle=False)
        yield name.removesuffix(".capture.json"), filled(envelope["record"], arrays)


if __name__ == "__main__":
    for name, capture in read_captures(sys.argv[1]):
        change = np.abs(capture["contact"].astype(float) - capture["no_contact"]).max()
        print(
            f"{name}: {capture['contact'].shape}, largest change {change:g} DN, lacks {len(capture['missing'])} parts"
        )
