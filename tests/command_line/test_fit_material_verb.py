"""``finray fit-material``: curves of blocks in, moduli, a picture and lines of a design out."""

import tomllib

import numpy as np
import pytest

from data_schemas import FingerDesign, MaterialFit
from data_schemas.storage import read_record
from tests.command_line.running import finray, succeed
from tests.compare.bench_blocks import measured


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("bench"), np.random.default_rng(3)
    for plates in ("lubricated", "confined"):
        curve = measured(rng, 0.17, 400.0, plates)
        rows = "".join(f"{d:.5f},{f:.5f}\n" for d, f in zip(curve.displacement_mm, curve.force_n, strict=True))
        (folder / f"{plates}.csv").write_text("displacement_mm,force_n\n" + rows)
    return folder


def test_two_blocks_give_what_a_design_needs(bench, tmp_path):
    blocks = "--on 20x20x10:lubricated --on 20x20x10:confined"
    out = tmp_path / "gel.json"
    told = succeed(f"fit-material {bench}/lubricated.csv {bench}/confined.csv {blocks} --out {out}")
    fit = read_record(out, MaterialFit)
    assert told.splitlines()[-1].startswith("look at:")
    assert "gel.png" in told.splitlines()[-1]
    assert (tmp_path / "gel.png").read_bytes().startswith(b"\x89PNG")
    assert fit.provenance is not None
    assert len(fit.provenance.input_sha256) == 2
    # the lines that are told are those of a design
    told_lines = "\n".join(
        line.strip() for line in told.partition("to copy into the design file of a finger:")[2].splitlines()
    )
    design = FingerDesign.model_validate(tomllib.loads(told_lines.partition("look at:")[0]))
    assert design.mechanics.gel.c10_mpa == pytest.approx(fit.moduli[0].posterior.estimate, rel=1e-3)
    assert design.origin["mechanics.gel.bulk_over_shear"] == "measured"
    again = finray(f"fit-material {bench}/lubricated.csv --on 20x20x10:lubricated --out {out}")
    assert again.status == 2
    assert "exists already and is not overwritten" in again.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("lubricated.csv confined.csv --on 20x20x10:lubricated", "give --on exactly once for each curve"),
        (
            "lubricated.csv --on 20x20:lubricated",
            "is neither a file nor a block; give a design (TOML)",
        ),
        (
            "lubricated.csv --on 20x20x10:slippery",
            "plates 'slippery' are not supported; give one of lubricated, bonded, confined",
        ),
        ("lubricated.csv --on 20x2.0.1x10:bonded", "the edges must be numbers in mm"),
        (
            "lubricated.csv --on 20x20x4:bonded",
            "pushes of a bonded block 4 mm high must increase",
        ),
        ("none.csv --on 20x20x10:bonded", "none.csv: no such file"),
        ("lubricated.csv", "--on"),
    ],
)
def test_mistakes_are_told(bench, tmp_path, arguments, message):
    curves = " ".join(f"{bench}/{word}" if word.endswith(".csv") else word for word in arguments.split())
    found = finray(f"fit-material {curves} --out {tmp_path}/x.json")
    assert found.status == 2
    assert message in " ".join(found.err.split())
    assert not list(tmp_path.iterdir())
